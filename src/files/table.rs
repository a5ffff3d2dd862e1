//! Columns of numbers as text, with or without a line that names them: `.csv`, `.txt`, `.xyz`.

use super::field::{
    Declared, FEWEST_COLUMNS, MOST_FIELDS, POSITION, names_coordinates, usual_names, with_underscores,
};
use super::text_records::{self, first_line};
use crate::scan::{ScalarType, ScanFile, TextFormat};

/// Largest number of bytes before the first line of numbers.
const MOST_BEFORE: usize = 64 << 10;

/// Where the numbers of a file begin, and the names of their columns.
pub(super) struct Table {
    /// Bytes before the first line of numbers.
    start: usize,
    names: Vec<String>,
    /// Whether a line of the file gave the names.
    is_named: bool,
}

impl Table {
    /// Looks for numbers in a file, or in its beginning. `None` if no line has at least three numbers.
    pub(super) fn find(bytes: &[u8]) -> Option<Self> {
        let (mut start, mut header) = (0, None);
        while let Some(line) = first_line(bytes.get(start..)?).filter(|_| start < MOST_BEFORE) {
            let format = TextFormat::of_line(line);
            let is_table = |count: &usize| (FEWEST_COLUMNS..=MOST_FIELDS).contains(count);
            if let Some(columns) = format.count_numbers(line).filter(is_table) {
                let given = header.map(|line| names_in(line, &format)).filter(|names| names.len() == columns);
                let is_named = given.is_some();
                return Some(Table { start, names: given.unwrap_or_else(|| usual_names(columns)), is_named });
            }
            start += line.len();
            header = (!line.trim().is_empty()).then_some(line).or(header);
        }
        None
    }

    /// Whether a line of the file names the coordinates.
    pub(super) fn names_coordinates(&self) -> bool {
        self.is_named && names_coordinates(self.names.iter().map(String::as_str))
    }

    /// Whether the numbers of a file, or of its beginning, look like points although nothing names them:
    /// there are many lines and not too many columns, most numbers in the first three columns have a decimal
    /// point, unlike counters, and the first column is not ascending, unlike times.
    pub(super) fn looks_like_points(&self, bytes: &[u8]) -> bool {
        const FEWEST_LINES: usize = 100;
        const MOST_LINES: usize = 1000;
        // The matrix of a pose has twelve numbers.
        const MOST_OF_POINTS: usize = 11;
        if self.is_named || self.names.len() > MOST_OF_POINTS {
            return false;
        }
        let Some(text) = bytes.get(self.start..) else { return false };
        let lines = text.split_inclusive(|&byte| byte == b'\n').filter(|line| line.ends_with(b"\n"));
        let lines = lines.take(MOST_LINES).map_while(|line| std::str::from_utf8(line).ok());
        let Some(format) = lines.clone().next().map(TextFormat::of_line) else { return false };
        let (mut count, mut fractions, mut last, mut rises) = (0, [0; 3], f64::NEG_INFINITY, true);
        for line in lines.take_while(|line| format.count_numbers(line) == Some(self.names.len())) {
            count += 1;
            for (at, text) in format.texts(line).into_iter().flatten().enumerate().take(POSITION.len()) {
                fractions[at] += usize::from(text.contains('.'));
                if at == 0 {
                    let value = text.trim_start().parse().unwrap_or(f64::NAN);
                    rises &= value >= last;
                    last = value;
                }
            }
        }
        count >= FEWEST_LINES && !rises && fractions.iter().all(|with| 2 * with >= count)
    }
}

/// Whether the first line of a file names coordinates between commas, semicolons or tabs: its lines may hold
/// other than numbers then, such as labels in words, but each is a point.
pub(super) fn starts_with_names(bytes: &[u8]) -> bool {
    let Some(line) = first_line(bytes).filter(|line| line.len() < bytes.len()) else { return false };
    let names: Vec<String> = line.trim().split([',', ';', '\t']).map(name_in).collect();
    names_coordinates(names.iter().map(String::as_str))
}

/// Parses a file. `None` if it has no lines of numbers, or if they would not be restored exactly.
pub(super) fn parse(bytes: &[u8]) -> Option<ScanFile> {
    let table = Table::find(bytes)?;
    let is_coordinate = |name: &str| POSITION.iter().any(|axis| name.eq_ignore_ascii_case(axis));
    let parse = |of_coordinates: Option<ScalarType>| {
        let fields = table.names.iter().map(|name| match of_coordinates {
            Some(scalar) if is_coordinate(name) => {
                Declared { name, scalar: Some(scalar), width: scalar.size() }
            }
            _ => Declared { name, scalar: None, width: 1 },
        });
        let fields: Vec<_> = fields.collect();
        text_records::parse(&fields, bytes, table.start, u64::MAX)
    };
    // Coordinates are floating-point numbers even if all of them are whole, unless doubles cannot hold them
    // exactly.
    parse(Some(ScalarType::F64)).or_else(|| parse(None))
}

/// The names of columns in a line, which is split like the lines below it.
fn names_in(line: &str, format: &TextFormat) -> Vec<String> {
    let is_mark = |c: char| c.is_whitespace() || "#%/\u{feff}".contains(c);
    let line = line.trim_start_matches(is_mark).trim_end();
    let separator = format.separator.character();
    let names = line.strip_suffix(separator).unwrap_or(line).split(separator);
    names.filter(|name| separator != ' ' || !name.is_empty()).map(name_in).collect()
}

/// A name without its quotation marks and its unit. ParaView and VeloView name the coordinates Points:0,
/// Points:1 and Points:2; Ouster's program names those of the first return X1, Y1 and Z1.
fn name_in(text: &str) -> String {
    let name = text.trim().trim_matches('"').split(['(', '[']).next().unwrap_or_default().trim();
    let number = name.strip_prefix("Points").and_then(|rest| rest.rsplit_once(':')?.1.parse::<usize>().ok());
    let first_return = name.strip_suffix('1').unwrap_or_default();
    let numbered = number.and_then(|number| POSITION.get(number));
    match numbered.or_else(|| POSITION.iter().find(|axis| first_return.eq_ignore_ascii_case(axis))) {
        Some(axis) => (*axis).to_owned(),
        None => with_underscores(name),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::tests::comes_back;
    use crate::files::{starts_as_scan, starts_as_scan_of_folder};

    fn names(scan: &ScanFile) -> Vec<(&str, &str)> {
        scan.layout.fields.iter().map(|field| (&field.name[..], field.scalar.name())).collect()
    }

    #[test]
    fn a_line_of_names_is_taken() {
        for (header, body) in [
            ("X,Y,Z,Intensity,laser id,t\n", "1.5,2,3,0,17,1.25\n-1,2,3,255,18,1300000000.5\n"),
            (
                "\u{feff}\"X\";\"Y [m]\";\"z(m)\";Intensity;laser id;t\r\n",
                "1.5;2;3;0;17;1.25\r\n-1;2;3;255;18;1300000000.5\r\n",
            ),
            (
                "# made by\n\n# X Y Z Intensity laser_id t\n",
                "1.5 2 3 0 17 1.25\n-1 2 3 255 18 1300000000.5\n",
            ),
            (
                "# frame num: 0\n# X1 (m), Y1 (m), Z1 (m), Intensity (photons), laser id, t\n",
                "1.5,2,3,0,17,1.25\n-1,2,3,255,18,1300000000.5\n",
            ),
            (
                "Points_m_XYZ:0,Points_m_XYZ:1,Points_m_XYZ:2,Intensity,laser_id,t\n",
                "1.5, 2, 3, 0, 17, 1.25\n-1, 2, 3, 255, 18, 1300000000.5",
            ),
        ] {
            let scan = comes_back("a.csv", [header, body].concat().into_bytes());
            let [x, y, z] = scan.layout.position.expect(header).map(|at| at as usize);
            assert_eq!((x, y, z), (0, 1, 2), "{header}");
            assert_eq!(scan.prefix, header.as_bytes());
            assert_eq!(scan.cloud.positions, [[1.5, 2.0, 3.0], [-1.0, 2.0, 3.0]]);
            assert_eq!(scan.cloud.intensity, [0.0, 255.0]);
            assert_eq!(
                names(&scan)[3..],
                [("Intensity", "u8"), ("laser_id", "u8"), ("t", "f64")],
                "{header}"
            );
            assert!(scan.suffix.is_empty());
        }
    }

    #[test]
    fn points_with_words_are_bytes_of_a_scan() {
        let file = b"x,y,z,label\n1.5,2,3,car\n-1,2,3,tree\n";
        assert!(starts_as_scan("a.csv", file) && starts_as_scan_of_folder("a.csv", file));
        assert!(comes_back("a.csv", file.to_vec()).is_opaque());
        for other in [&b"time,label\n1,car\n"[..], b"words, but x, y and z\n", b""] {
            assert!(!starts_as_scan_of_folder("a.csv", other));
        }
    }

    #[test]
    fn columns_without_names_are_those_of_kitti() {
        let scan =
            comes_back("a.xyz", b"-0.45903\t-0.28572\t0\t0\t17\t-300\n1\t2\t3\t4\t5\t70000\n".to_vec());
        let expected = [
            ("x", "f32"),
            ("y", "f32"),
            ("z", "f32"),
            ("intensity", "u8"),
            ("column_5", "u8"),
            ("column_6", "i32"),
        ];
        assert_eq!(names(&scan), expected);
        assert_eq!((scan.records, scan.layout.position), (2, Some([0, 1, 2])));
        // Integers that doubles cannot hold exactly, as in fields of 64 bits.
        let scan = comes_back("a.xyz", b"10035219362488647680 2 3\n8751164152776630337 2 3\n".to_vec());
        assert_eq!(names(&scan), [("x", "u64"), ("y", "u8"), ("z", "u8")]);
        // Preceded by the number of points, as in some `.xyz` files.
        let scan = comes_back("a.xyz", b"2\n1 2 3\n4 5 6\n".to_vec());
        assert_eq!((scan.records, &scan.prefix[..]), (2, &b"2\n"[..]));
        // Names for another number of columns.
        let scan = comes_back("a.txt", b"x y\n1 2 3\n".to_vec());
        assert_eq!(names(&scan), [("x", "f32"), ("y", "f32"), ("z", "f32")]);
    }

    #[test]
    fn odd_ends_are_kept() {
        for (body, records, suffix) in [
            ("1,2,3\r\n4,5,6\r\n\r\n\r\n", 2, "\r\n\r\n"),
            ("1,2,3\n4,5,6\n\n\n", 2, "\n\n"),
            ("1,2,3\n4,5,6", 2, ""),
            ("1,2,3\n4,5,", 1, "4,5,"),
            ("1,2,3,\n4,5,6,\n", 2, ""),
            ("1,2,3", 1, ""),
            ("1.25,2,3\n1.50,2,3\n1.2", 2, "1.2"),
            ("1.25,2,3\n1.50,2,3\n1.2,2,3", 2, "1.2,2,3"),
            ("nan,-nan,inf\n-inf,0,-0\n", 2, ""),
            ("1, 2, 3\n4, 5,6\n", 1, "4, 5,6\n"),
        ] {
            let scan = comes_back("a.csv", body.as_bytes().to_vec());
            assert_eq!((scan.records, &scan.suffix[..]), (records, suffix.as_bytes()), "{body:?}");
        }
    }

    #[test]
    fn what_is_no_table_is_opaque() {
        for body in ["", "\n", "x,y,z\n", "1 2\n3 4\n", "a b c\nd e f\n", "1,5;2,5;3,5\n", "1,,3\n", "\u{ff}"]
        {
            assert!(comes_back("a.csv", body.as_bytes().to_vec()).is_opaque(), "{body:?}");
            assert!(!starts_as_scan("a.csv", body.as_bytes()), "{body:?}");
        }
        let late = [vec![b'x'; MOST_BEFORE + 1], b"\n1 2 3\n".to_vec()].concat();
        assert!(comes_back("a.csv", late).is_opaque());
        assert!(comes_back("a.csv", b"1 ".repeat(MOST_FIELDS + 1)).is_opaque());
        assert!(!comes_back("a.csv", b"1 ".repeat(MOST_FIELDS)).is_opaque());
        assert!(comes_back("a.csv", vec![0xff; 100]).is_opaque());
    }

    #[test]
    fn a_folder_gives_what_looks_like_points() {
        let lines = |count: usize, line: &dyn Fn(f64) -> String| {
            (0..count).map(|n| line(n as f64)).collect::<String>()
        };
        let point =
            |n: f64| format!("{:.3} {:.3} {:.3} 7\n", 9.0 * (n / 9.0).cos(), 9.0 * (n / 9.0).sin(), n / 99.0);
        let timed = |n: f64| format!("{:.3} {}", n / 10.0, point(n));
        let pose = |n: f64| ["1.5"; 8].join(" ") + " " + &point(n);
        let counters = |n: f64| format!("{} {} {} {}\n", 9.0 - n % 9.0, n % 7.0, n % 5.0, n / 3.0);
        for (text, is_taken) in [
            (lines(100, &point), true),
            (lines(99, &point), false),
            (lines(200, &timed), false),
            (lines(200, &pose), false),
            (lines(200, &counters), false),
            ("a b c d\n".to_owned() + &lines(200, &point), false),
            ("x y z d\n".to_owned() + &lines(1, &point), true),
        ] {
            assert!(starts_as_scan("a.txt", text.as_bytes()));
            assert_eq!(
                starts_as_scan_of_folder("a.txt", text.as_bytes()),
                is_taken,
                "{}",
                text.lines().next().unwrap()
            );
            assert!(starts_as_scan_of_folder("a.xyz", text.as_bytes()));
        }
    }
}

//! What the fit finds.
use lidarpc::internals::files::parse;
use lidarpc::internals::scanner::{REACH, firings::fit};
fn main() {
    for path in std::env::args().skip(1) {
        let bytes = std::fs::read(&path).unwrap();
        let name = path.rsplit('/').next().unwrap().to_owned();
        let scan = parse(&name, bytes);
        let t = std::time::Instant::now();
        match fit(std::slice::from_ref(&scan)) {
            None => println!("{path}: none {:?}", t.elapsed()),
            Some((scanner, share)) => {
                let took = t.elapsed();
                let p = scanner.project(&scan.cloud, REACH);
                let mut exact = 0;
                let mut rows = vec![(0, 0, 0); scanner.rows()];
                let order = scanner.file_order(&p.image);
                for f in order.iter().filter(|f| f.steps > 0) {
                    let point = p.point_of_cell[(f.row as usize, f.column as usize)] as usize;
                    let g = scanner.build().coordinates;
                    let q = scanner.position(f, 0.0).map(|m| g.nearest(m).to_bits());
                    let w = scan.cloud.positions[point].map(f32::to_bits);
                    exact += usize::from(q == w);
                    rows[f.row as usize].0 += 1;
                    rows[f.row as usize].1 += usize::from(q == w);
                    rows[f.row as usize].2 += usize::from(q[2] == w[2]);
                }
                println!(
                    "{path}: {scanner}; share {share:.4}, exact {:.5}, columns {}, strays {}, full {}, of {} {:?}",
                    exact as f64 / p.image.returns().max(1) as f64,
                    p.image.columns.len(),
                    p.strays.len(),
                    p.image.is_full,
                    scan.records,
                    took
                );
                if std::env::var("LASERS").is_ok() {
                    for (r, l) in rows.iter().zip(scanner.lasers()) {
                        println!(
                            "{} {} n {} exact {:.3} z {:.3}",
                            l.elevation,
                            l.azimuth,
                            r.0,
                            r.1 as f64 / r.0.max(1) as f64,
                            r.2 as f64 / r.0.max(1) as f64
                        );
                    }
                    println!("{:?}", scanner.build().timing);
                }
            }
        }
    }
}

//! The estimated motion of the scanner, compared with the true one.

use crate::common::scans::small;
use lidarpc::internals::files::parse;
use lidarpc::internals::inter::registration::{
    Pose, Registration, RegistrationConfig, RegistrationMethod, RigidMotion, Surface, register,
};
use lidarpc::internals::scanner::hdl64::{Hdl64, fit, project};
use lidarpc::internals::scanner::{REACH, RangeImage};
use lidarpc::internals::study::synth::{SynthConfig, SynthFrame, drive};

/// Images of a drive, and the motion that led to each of them except the first.
struct Drive {
    scanner: Hdl64,
    images: Vec<RangeImage>,
    motions: Vec<RigidMotion>,
}

fn simulated(config: &SynthConfig) -> Drive {
    let frames: Vec<SynthFrame> = drive(config).collect();
    let scans: Vec<_> = frames.iter().map(|frame| parse(&frame.name, frame.to_bin())).collect();
    let scanner = fit(&scans).unwrap();
    let images = scans.iter().map(|scan| project(&scanner, &scan.cloud, REACH).image).collect();
    let poses: Vec<_> = frames.iter().map(|frame| motion_of(&frame.pose)).collect();
    let motions = poses.windows(2).map(|pair| pair[0].then(&pair[1].inverse())).collect();
    Drive { scanner, images, motions }
}

fn motion_of(pose: &[f64; 12]) -> RigidMotion {
    RigidMotion {
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| pose[4 * i + j])),
        translation: std::array::from_fn(|i| pose[4 * i + 3]),
    }
}

impl Drive {
    fn surface(&self, frame: usize) -> Surface {
        Surface::of(&self.scanner, &self.images[frame].columns, &self.images[frame].steps)
    }

    fn register(&self, frame: usize, initial: &Pose, config: &RegistrationConfig) -> Option<Registration> {
        register(&self.surface(frame), &self.images[frame + 1], &self.scanner, initial, config)
    }
}

/// The difference of two motions in metres, and in degrees.
fn apart(a: &RigidMotion, b: &RigidMotion) -> (f64, f64) {
    let rest = a.then(&b.inverse()).pose();
    let [x, y, z] = rest.translation;
    ((x * x + y * y + z * z).sqrt(), rest.angle().to_degrees())
}

#[test]
fn a_known_motion_is_found() {
    let config = SynthConfig { frames: 4, thinning: 4, traffic: false, ..SynthConfig::default() };
    for config in [config.clone(), SynthConfig { rolling: false, seed: 5, ..config }] {
        let drive = simulated(&config);
        let mut initial = Pose::default();
        for frame in 0..3 {
            let found = drive.register(frame, &initial, &RegistrationConfig::default()).unwrap();
            let (metres, degrees) = apart(&found.pose.motion(), &drive.motions[frame]);
            println!("{metres:.4} m, {degrees:.4} degrees, {found:?}");
            assert!(metres < 0.02 && degrees < 0.05, "{metres} m, {degrees} degrees");
            initial = found.pose;
        }
    }
}

/// Rings on the ground and walls along the street look the same from everywhere.
#[test]
fn a_fast_car_is_followed_from_the_first_frame_on() {
    for speed in [1.5, 2.5, -0.8] {
        let drive = simulated(&SynthConfig { frames: 2, thinning: 2, speed, ..SynthConfig::default() });
        let found = drive.register(0, &Pose::default(), &RegistrationConfig::default()).unwrap();
        let (metres, degrees) = apart(&found.pose.motion(), &drive.motions[0]);
        println!("{speed}: {metres:.4} m, {degrees:.4} degrees, {found:?}");
        assert!(metres < 0.05 && degrees < 0.1, "{speed}: {metres} m, {degrees} degrees");
    }
}

/// Points alone do not reveal the distance travelled along a street, as rings on the ground move along. They
/// do reveal the rotation.
#[test]
fn the_articles_method_finds_a_turn() {
    let config = SynthConfig { frames: 2, speed: 0.0, yaw_rate: 0.02, ..SynthConfig::default() };
    let drive = simulated(&config);
    assert!(drive.motions[0].pose().angle().to_degrees() > 0.3);
    let config = RegistrationConfig { method: RegistrationMethod::Icp, ..RegistrationConfig::default() };
    let found = drive.register(0, &Pose::default(), &config).unwrap();
    let (metres, degrees) = apart(&found.pose.motion(), &drive.motions[0]);
    assert!(metres < 0.05 && degrees < 0.1, "{metres} m, {degrees} degrees");
}

#[test]
fn a_scanner_at_rest_has_not_moved() {
    let config = SynthConfig { frames: 2, thinning: 2, speed: 0.0, yaw_rate: 0.0, ..SynthConfig::default() };
    let found = simulated(&config).register(0, &Pose::default(), &RegistrationConfig::default()).unwrap();
    let (metres, degrees) = apart(&found.pose.motion(), &RigidMotion::default());
    assert!(metres < 0.01 && degrees < 0.05, "{metres} m, {degrees} degrees");
}

#[test]
fn what_cannot_be_registered_is_noticed() {
    let here = simulated(&SynthConfig { thinning: 4, ..small(1, 2) });
    let nothing = RangeImage::new(here.scanner.rows(), here.images[0].columns.clone());
    let mut one = nothing.clone();
    one.steps[(0, 0)] = 5000;
    for method in [RegistrationMethod::Projective, RegistrationMethod::Icp] {
        let config = RegistrationConfig { method, ..RegistrationConfig::default() };
        let register = |reference: &RangeImage, current: &RangeImage| {
            let surface = Surface::of(&here.scanner, &reference.columns, &reference.steps);
            register(&surface, current, &here.scanner, &Pose::default(), &config)
        };
        for (reference, current) in
            [(&nothing, &here.images[0]), (&here.images[0], &nothing), (&one, &one), (&one, &here.images[0])]
        {
            assert!(register(reference, current).is_none(), "{method:?}");
        }
        // A wall close in front of everything else.
        let mut wall = here.images[0].clone();
        for row in 0..wall.steps.rows() {
            wall.steps.row_mut(row).iter_mut().for_each(|steps| *steps = (*steps).min(900));
        }
        let found = register(&here.images[0], &wall);
        assert!(found.is_none_or(|found| found.fit < 0.6), "{method:?} {found:?}");
    }
}

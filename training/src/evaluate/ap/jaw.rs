//! One grasp of the parallel jaw, judged against the exact scene: collision, emptiness, force closure.
//!
//! Dimensions and order of the checks are those of the benchmark that the paper's AP comes from
//! (graspnetAPI); what differs is said where it differs.

use graspd_sim::mesh::Mesh;
use nalgebra::{Isometry3, Point3, Unit, Vector3};

use super::surface::cast;

/// Depth `D_Depth` of the fingers beyond the gripper's origin, metres (Supplementary Note 3).
pub const DEPTH_M: f64 = 0.06;
/// Height `D_Height` of the fingers, metres (Supplementary Note 3).
pub const HEIGHT_M: f64 = 0.02;
/// Largest opening `D_Width`, metres (Supplementary Note 3).
pub const MAX_WIDTH_M: f64 = 0.12;
/// How far fingers reach behind the gripper's origin, metres.
pub(crate) const BEHIND_M: f64 = 0.02;
/// Thickness of a finger, and of the base that carries them, metres.
pub(crate) const FINGER_M: f64 = 0.01;
/// With fewer points between the jaws the grasp is empty.
const LEAST_POINTS: usize = 10;
/// Rays from each jaw, along its depth and across its height.
const RAYS: [usize; 2] = [25, 5];
/// Chords that are narrower than the widest by less than this are as wide, metres.
const SAME_M: f64 = 1e-4;

/// Friction coefficients at which grasps are scored, from the easiest. The paper's AP averages the last five.
pub const FRICTIONS: [f64; 6] = [1.2, 1.0, 0.8, 0.6, 0.4, 0.2];

/// A parallel-jaw grasp. The hand frame has z along the approach and y along the closing direction; its origin
/// lies between the fingers, [`DEPTH_M`] behind their tips.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JawGrasp {
    /// Pose of the gripper, world frame.
    pub world_from_jaw: Isometry3<f64>,
    /// Distance between the jaws before they close, metres.
    pub width_m: f64,
    /// Where contact is expected, world frame: decides between chords that are as wide as the widest.
    pub expected: Point3<f64>,
}

/// An object of the exact scene.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// Its surface.
    pub mesh: &'a Mesh,
    /// Its pose, world frame.
    pub world_from_mesh: Isometry3<f64>,
}

/// What became of a grasp.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub enum Verdict {
    /// The gripper touches something before it closes.
    Collision,
    /// There is (nearly) nothing between the jaws.
    Empty,
    /// The jaws close on something that slips at every friction.
    NoClosure,
    /// Force closure from this friction on.
    Holds {
        /// The smallest of [`FRICTIONS`] that suffices.
        friction: f64,
    },
}

impl Verdict {
    /// True when the grasp holds at friction `mu`.
    pub fn holds_at(self, mu: f64) -> bool {
        matches!(self, Self::Holds { friction } if friction <= mu + 1e-9)
    }
}

/// Number of points between the jaws before they close; `None` when a finger or the base is in the way of one. Points
/// in the world frame, of which only those near the gripper matter.
pub(crate) fn between(grasp: &JawGrasp, points: &[Point3<f64>]) -> Option<usize> {
    let jaw_from_world = grasp.world_from_jaw.inverse();
    let half = 0.5 * grasp.width_m;
    let mut between = 0;
    for point in points {
        let p = jaw_from_world * point;
        if p.x.abs() >= 0.5 * HEIGHT_M || p.y.abs() >= half + FINGER_M {
            continue;
        }
        let along_fingers = p.z > -BEHIND_M && p.z < DEPTH_M;
        let in_finger = along_fingers && p.y.abs() > half;
        let in_base = p.z > -BEHIND_M - FINGER_M && p.z <= -BEHIND_M;
        if in_finger || in_base {
            return None;
        }
        between += usize::from(along_fingers);
    }
    Some(between)
}

/// Judges a grasp: against all points of the scene (objects and table, world frame), then on its object.
pub fn judge(grasp: &JawGrasp, points: &[Point3<f64>], target: &Target<'_>) -> Verdict {
    match between(grasp, points) {
        None => return Verdict::Collision,
        Some(count) if count < LEAST_POINTS => return Verdict::Empty,
        Some(_) => {}
    }
    match contacts(grasp, target) {
        None => Verdict::NoClosure,
        Some(contacts) => {
            smallest_friction(&contacts).map_or(Verdict::NoClosure, |friction| Verdict::Holds { friction })
        }
    }
}

/// A point on a surface, with its normal.
pub(crate) type Contact = (Point3<f64>, Unit<Vector3<f64>>);

/// What two rays of one line found.
struct Chord {
    width_m: f64,
    /// Distance from where contact is expected, across the line, metres.
    off_m: f64,
    contacts: [Contact; 2],
}

/// Where the jaws meet the object: rays go from each jaw to the other, in pairs on one line; the pair with the
/// widest chord touches first once the object has slid to the middle, and of those as wide as it the one nearest to
/// where contact was expected.
///
/// The benchmark closes along one line, through the finger tips' middle, in a signed distance grid; this jaw is
/// three times as deep as the benchmark's, so that all of the pads may touch, and the surface is exact. Its one line
/// leaves no choice; here flat sides leave many, and the planner's own expectation decides.
fn contacts(grasp: &JawGrasp, target: &Target<'_>) -> Option<[Contact; 2]> {
    let pose = &grasp.world_from_jaw;
    let half = 0.5 * grasp.width_m;
    let expected = pose.inverse_transform_point(&grasp.expected);
    let inwards = pose.rotation * Vector3::y_axis();
    let mut chords: Vec<Chord> = Vec::new();
    for i in 0..RAYS[0] {
        for j in 0..RAYS[1] {
            // Middles of equal cells, so that no ray runs along an edge of the pad.
            let z = DEPTH_M * (i as f64 + 0.5) / RAYS[0] as f64;
            let x = HEIGHT_M * ((j as f64 + 0.5) / RAYS[1] as f64 - 0.5);
            let [left, right] = [-half, half].map(|y| pose * Point3::new(x, y, z));
            let (Some(a), Some(b)) = (
                cast(target.mesh, &target.world_from_mesh, &left, &inwards),
                cast(target.mesh, &target.world_from_mesh, &right, &-inwards),
            ) else {
                continue;
            };
            let width_m = grasp.width_m - a.distance_m - b.distance_m;
            if width_m <= 0.0 {
                continue;
            }
            let contacts = [
                (left + inwards.into_inner() * a.distance_m, a.normal),
                (right - inwards.into_inner() * b.distance_m, b.normal),
            ];
            chords.push(Chord { width_m, off_m: (x - expected.x).hypot(z - expected.z), contacts });
        }
    }
    touching(chords).map(|chord| chord.contacts)
}

/// The chord that touches first. The widest is found before any choice among its equals: else many small steps
/// from one to the next would lead away from it.
fn touching(chords: Vec<Chord>) -> Option<Chord> {
    let widest_m = chords.iter().map(|c| c.width_m).fold(0.0, f64::max);
    let as_wide = chords.into_iter().filter(|c| c.width_m > widest_m - SAME_M);
    as_wide.min_by(|a, b| a.off_m.total_cmp(&b.off_m))
}

/// Nguyen's antipodal test (1988) at each friction, from the easiest, until the first that fails: the line
/// through both contacts lies in both friction cones. As in the benchmark the side of a normal does not count.
fn smallest_friction(contacts: &[Contact; 2]) -> Option<f64> {
    let worst = worst_angle(contacts)?;
    FRICTIONS.into_iter().take_while(|mu| worst <= mu.atan()).last()
}

/// Largest angle between the line through both contacts and a normal, radians: the friction cone that force closure
/// needs. `None` for contacts that are one.
pub(crate) fn worst_angle(contacts: &[Contact; 2]) -> Option<f64> {
    let line = Unit::try_new(contacts[1].0 - contacts[0].0, 1e-9)?;
    let angle = |(_, normal): &Contact| line.dot(normal).abs().min(1.0).acos();
    Some(contacts.iter().map(angle).fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::super::surface::{sample, table_points};
    use super::*;

    /// A box of 3 x 4 x 5 cm on the table, and its points with those of the table.
    fn scene() -> (Mesh, Isometry3<f64>, Vec<Point3<f64>>) {
        let mesh = Mesh::cuboid(Vector3::new(0.015, 0.02, 0.025));
        let pose = Isometry3::translation(0.0, 0.0, 0.0251);
        let mut points: Vec<_> = sample(&mesh).iter().map(|p| pose * p).collect();
        points.extend(table_points());
        (mesh, pose, points)
    }

    /// From above, tips 1 cm over the table, turned by `yaw` about the vertical.
    fn from_above(yaw: f64, aside: f64, width_m: f64) -> JawGrasp {
        let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        let t = nalgebra::Translation3::new(0.0, aside, 0.01 + DEPTH_M);
        let world_from_jaw = Isometry3::from_parts(t, turn * down);
        JawGrasp { world_from_jaw, width_m, expected: Point3::new(0.0, 0.0, 0.025) }
    }

    fn judged(grasp: &JawGrasp) -> Verdict {
        let (mesh, pose, points) = scene();
        judge(grasp, &points, &Target { mesh: &mesh, world_from_mesh: pose })
    }

    #[test]
    fn a_straight_grasp_on_a_box_holds_at_the_least_friction() {
        assert_eq!(judged(&from_above(0.0, 0.0, 0.08)), Verdict::Holds { friction: 0.2 });
    }

    #[test]
    fn a_grasp_turned_by_30_degrees_needs_friction_0_6() {
        let verdict = judged(&from_above(30f64.to_radians(), 0.0, 0.1));
        assert_eq!(verdict, Verdict::Holds { friction: 0.6 });
        assert!(verdict.holds_at(0.6) && !verdict.holds_at(0.4));
    }

    #[test]
    fn a_jaw_in_the_box_or_in_the_table_collides() {
        assert_eq!(judged(&from_above(0.0, 0.02, 0.05)), Verdict::Collision);
        let mut low = from_above(0.0, 0.0, 0.08);
        low.world_from_jaw.translation.z -= 0.02;
        assert_eq!(judged(&low), Verdict::Collision);
    }

    #[test]
    fn small_steps_do_not_lead_away_from_the_widest_chord() {
        let contact = (Point3::origin(), Vector3::y_axis());
        // Each 0.08 mm narrower than the last and nearer to where contact is expected: a wedge.
        let wedge = (0..20).map(|i| Chord {
            width_m: 0.04 - 8e-5 * f64::from(i),
            off_m: 0.02 - 1e-3 * f64::from(i),
            contacts: [contact; 2],
        });
        let chosen = touching(wedge.collect()).unwrap();
        assert!(chosen.width_m > 0.04 - SAME_M && chosen.off_m < 0.02, "{} m", chosen.width_m);
        assert!(touching(Vec::new()).is_none());
    }

    #[test]
    fn a_jaw_around_nothing_is_empty() {
        assert_eq!(judged(&from_above(0.0, 0.2, 0.08)), Verdict::Empty);
    }
}

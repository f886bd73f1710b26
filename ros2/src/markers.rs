//! `visualization_msgs/MarkerArray` of a plan: the hand at its best grasps, coloured by score, with the way to them.

use std::collections::HashMap;

use graspd_client::Grasp;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::hand::{HandModel, Shape};
use crate::messages::{ColorRGBA, Header, Marker, MarkerArray, Vector3 as Scale, action, shape};
use crate::poses;

/// Opacity of the best grasp and of the others.
const OPACITY: [f32; 2] = [0.9, 0.3];
/// Diameter of an arrow's shaft and of its head, metres.
const ARROW_M: [f64; 2] = [0.004, 0.008];
/// Diameter of a contact's ball, metres.
const CONTACT_M: f64 = 0.006;
/// Height of a capital, metres.
const LETTER_M: f64 = 0.015;

/// Red for 0, yellow for a half, green for 1.
pub fn color(score: f64, opacity: f32) -> ColorRGBA {
    let share = if score.is_finite() { score.clamp(0.0, 1.0) as f32 } else { 0.0 };
    ColorRGBA { r: (2.0 - 2.0 * share).min(1.0), g: (2.0 * share).min(1.0), b: 0.1, a: opacity }
}

/// Markers of the best `count` grasps. The first deletes what an earlier plan has left, so that each array is a whole picture.
///
/// Namespaces: `hand` (shapes at contact), `approach` (an arrow from pre-grasp to grasp), `contacts` (balls), `score` (texts).
/// Without a hand's model there are arrows, balls and texts.
pub fn markers(header: &Header, grasps: &[Grasp], model: Option<&HandModel>, count: usize) -> MarkerArray {
    let clear = Marker { header: header.clone(), action: action::DELETEALL, ..Marker::default() };
    let mut picture = Picture { header, color: ColorRGBA::default(), markers: vec![clear] };
    for (rank, grasp) in grasps.iter().take(count).enumerate() {
        if let Some(at) = poses::of_wire(grasp.wrist_pose_in_camera.as_ref().and_then(|p| p.pose.as_ref())) {
            picture.color = color(grasp.score, OPACITY[usize::from(rank > 0)]);
            picture.grasp(rank, grasp, &at, model);
        }
    }
    MarkerArray { markers: picture.markers }
}

/// Markers as they are added, with the colour of the grasp that is drawn.
struct Picture<'a> {
    header: &'a Header,
    color: ColorRGBA,
    markers: Vec<Marker>,
}

impl Picture<'_> {
    fn marker(&self, ns: &str, kind: i32, pose: &Isometry3<f64>, scale: Vector3<f64>) -> Marker {
        Marker {
            header: self.header.clone(),
            ns: ns.to_owned(),
            id: self.markers.len() as i32,
            kind,
            action: action::ADD,
            pose: poses::message(pose),
            scale: Scale { x: scale.x, y: scale.y, z: scale.z },
            color: self.color,
            ..Marker::default()
        }
    }

    fn grasp(&mut self, rank: usize, grasp: &Grasp, at: &Isometry3<f64>, model: Option<&HandModel>) {
        for (pose, shape) in model.iter().flat_map(|m| m.shapes(&joints(grasp))) {
            self.hand_shape(&(at * pose), shape);
        }
        let before = grasp.pregrasp_pose_in_camera.as_ref().and_then(|p| p.pose.as_ref());
        if let Some((from, length_m)) = poses::of_wire(before).and_then(|before| way(&before, at, model)) {
            let scale = Vector3::new(length_m, ARROW_M[0], ARROW_M[1]);
            self.markers.push(self.marker("approach", shape::ARROW, &from, scale));
        }
        // Without a camera's pose in the request its frame is the world's.
        let points: Vec<_> =
            grasp.contacts.iter().map(|c| poses::point(&poses::vector(c.point.as_ref()))).collect();
        if !points.is_empty() {
            let scale = Vector3::repeat(CONTACT_M);
            let balls = self.marker("contacts", shape::SPHERE_LIST, &Isometry3::identity(), scale);
            self.markers.push(Marker { points, ..balls });
        }
        let place = Translation3::from(at.translation.vector).into();
        let letters = self.marker("score", shape::TEXT_VIEW_FACING, &place, Vector3::new(0.0, 0.0, LETTER_M));
        let text = format!("{}: {:.2}", rank + 1, grasp.score);
        self.markers.push(Marker { text, color: ColorRGBA { a: 1.0, ..self.color }, ..letters });
    }

    fn hand_shape(&mut self, pose: &Isometry3<f64>, shape: &Shape) {
        let (kind, scale, points) = match shape {
            Shape::Box(edges) => (shape::CUBE, *edges, Vec::new()),
            Shape::Cylinder { radius_m, length_m } => {
                (shape::CYLINDER, Vector3::new(2.0 * radius_m, 2.0 * radius_m, *length_m), Vec::new())
            }
            Shape::Sphere(radius_m) => (shape::SPHERE, Vector3::repeat(2.0 * radius_m), Vec::new()),
            Shape::Mesh(corners) => {
                (shape::TRIANGLE_LIST, Vector3::repeat(1.0), corners.iter().map(poses::point).collect())
            }
        };
        self.markers.push(Marker { points, ..self.marker("hand", kind, pose, scale) });
    }
}

/// Positions when the pads touch.
fn joints(grasp: &Grasp) -> HashMap<&str, f64> {
    let Some(joints) = &grasp.joints else { return HashMap::new() };
    joints.names.iter().map(String::as_str).zip(joints.contact.iter().copied()).collect()
}

/// Where an arrow begins whose x axis is the way to the grasp, and its length; at the tool point where that is known.
fn way(
    before: &Isometry3<f64>,
    at: &Isometry3<f64>,
    model: Option<&HandModel>,
) -> Option<(Isometry3<f64>, f64)> {
    let tool = model.map_or_else(Point3::origin, |m| m.tool_point);
    let (from, to) = (before * tool, at * tool);
    let length_m = (to - from).norm();
    (length_m > 1e-6).then(|| {
        let turn = Rotation3::rotation_between(&Vector3::x(), &(to - from));
        // Straight against x any half turn about an axis normal to it will do.
        let turn =
            turn.unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
        (Isometry3::from_parts(from.into(), UnitQuaternion::from_rotation_matrix(&turn)), length_m)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::answer::tests::grasp;
    use crate::hand::tests::{geometry, hand};

    fn of(markers: &MarkerArray, ns: &str) -> Vec<Marker> {
        markers.markers.iter().filter(|m| m.ns == ns).cloned().collect()
    }

    #[test]
    fn the_picture_is_whole_and_in_the_images_frame() {
        let header = Header { frame_id: "optical".into(), ..Header::default() };
        let model = HandModel::new(&hand(), &geometry());
        let drawn = markers(&header, &[grasp(0.9), grasp(0.2), grasp(0.1)], Some(&model), 2);
        assert_eq!(drawn.markers[0].action, action::DELETEALL);
        assert!(drawn.markers.iter().all(|m| m.header == header));
        assert_eq!(of(&drawn, "hand").len(), 4);
        let mut ids: Vec<i32> = drawn.markers.iter().map(|m| m.id).collect();
        ids.dedup();
        assert_eq!(ids.len(), drawn.markers.len());
        let text = &of(&drawn, "score")[0];
        assert_eq!((text.text.as_str(), text.kind), ("1: 0.90", shape::TEXT_VIEW_FACING));
        // The grasp stands at z = 1 turned about x by half a turn; its pre-grasp is 0.1 before it along z.
        let palm = &of(&drawn, "hand")[0];
        assert_eq!((palm.pose.position.z, palm.kind, palm.scale.x), (1.0, shape::CUBE, 0.02));
        let arrow = &of(&drawn, "approach")[0];
        assert!((arrow.scale.x - 0.1).abs() < 1e-9, "{arrow:?}");
        assert_eq!(of(&drawn, "contacts")[0].points.len(), 1);
        assert!(of(&drawn, "hand")[0].color.a > of(&drawn, "hand")[2].color.a);
    }

    #[test]
    fn no_grasp_deletes_what_was_there() {
        let none = markers(&Header::default(), &[], None, 5);
        assert_eq!(none.markers.len(), 1);
        assert_eq!(none.markers[0].action, action::DELETEALL);
        // Without a model there is still something to see.
        let bare = markers(&Header::default(), &[grasp(0.5)], None, 5);
        assert_eq!(
            (of(&bare, "hand").len(), of(&bare, "approach").len(), of(&bare, "score").len()),
            (0, 1, 1)
        );
    }

    #[test]
    fn colours_go_from_red_to_green() {
        assert_eq!(color(0.0, 1.0), ColorRGBA { r: 1.0, g: 0.0, b: 0.1, a: 1.0 });
        assert_eq!(color(0.5, 1.0), ColorRGBA { r: 1.0, g: 1.0, b: 0.1, a: 1.0 });
        assert_eq!(color(1.0, 0.5), ColorRGBA { r: 0.0, g: 1.0, b: 0.1, a: 0.5 });
        assert_eq!(color(f64::NAN, 1.0), color(0.0, 1.0));
    }

    #[test]
    fn an_arrow_points_from_pregrasp_to_grasp() {
        for to in [[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.02, -0.05]] {
            let to = Vector3::from(to);
            let (from, length) = way(&Isometry3::identity(), &Translation3::from(to).into(), None).unwrap();
            let tip = from * Point3::new(length, 0.0, 0.0);
            assert!((tip.coords - to).norm() < 1e-9, "{to:?} {tip:?}");
        }
        assert!(way(&Isometry3::identity(), &Isometry3::identity(), None).is_none());
    }
}

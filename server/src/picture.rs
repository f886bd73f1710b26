//! A call, or a frame of a servo stream, as viewers show it: depth, lens and place of each camera, its points, grasps
//! and the hand that takes the best of them. The same messages for recordings and for the live view.

mod cloud;

use std::sync::Arc;

use graspd_hands::{CollisionShape, Hand, Shape};
use graspd_planner::frame::Frame;
use graspd_proto::v1;
use graspd_proto::v1::hand_task_result::Outcome;
use graspd_proto::v1::plan_record::Request;
use graspd_recording::{Bundle, SERVO_TOPIC, STATS_TOPIC, Schema, foxglove};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::convert::EncodedFrame;

/// Points of a camera that are drawn.
const MOST_POINTS: usize = 40_000;
/// A hand with more triangles is drawn by its collision shapes.
const MOST_TRIANGLES: usize = 20_000;
/// The hand where it touches, and where it comes from.
const AT_CONTACT: foxglove::Color = foxglove::Color { r: 0.25, g: 0.5, b: 0.9, a: 0.9 };
const AT_PREGRASP: foxglove::Color = foxglove::Color { r: 0.6, g: 0.6, b: 0.6, a: 0.25 };
const CONTACT: foxglove::Color = foxglove::Color { r: 0.95, g: 0.75, b: 0.1, a: 1.0 };

/// Everything that is to be seen of a call; what the bundle does not want is not made.
pub(crate) fn draw_call(bundle: &mut Bundle, record: v1::PlanRecord, hands: &[Arc<Hand>]) {
    let frames = match &record.request {
        Some(Request::PlanGrasps(plan)) => plan.frames.clone(),
        Some(Request::PlanMultiHand(plan)) => plan.frames.clone(),
        None => Vec::new(),
    };
    let results = record.results.clone();
    bundle.push_plan(record);
    for (i, wire) in frames.into_iter().enumerate() {
        // A frame that is none was refused; what was sent is there all the same.
        let Ok(encoded) = EncodedFrame::parse(wire, String::new()) else { continue };
        camera(bundle, &format!("/camera/{i}"), &encoded, true);
    }
    let several = results.len() > 1;
    for result in &results {
        let Some(Outcome::Response(answer)) = &result.outcome else { continue };
        let topic = |name: &str| match several {
            true => format!("/grasps/{}/{name}", topic_name(&result.task_id)),
            false => format!("/grasps/{name}"),
        };
        if let Some(stats) = &answer.stats {
            bundle.push(STATS_TOPIC, Schema::PlanStats, stats);
        }
        let hand = answer.stats.as_ref().and_then(|stats| {
            hands.iter().find(|h| stats.hand.strip_prefix("hands/") == Some(h.id.as_str()))
        });
        let shown = Shown {
            world: world(answer),
            plan_id: &answer.plan_id,
            hand: hand.map(Arc::as_ref),
            grasps: &answer.grasps,
        };
        poses(bundle, topic("poses"), &shown);
        scene(bundle, topic("scene"), &shown);
        cloud::cloud(bundle, topic("points"), &shown);
    }
}

/// Everything that is to be seen of the answer to a servo stream's frame.
pub(crate) fn draw_servo(
    bundle: &mut Bundle,
    frame: &EncodedFrame,
    answer: &v1::ServoGraspResponse,
    hand: &Hand,
) {
    camera(bundle, "/servo/camera", frame, false);
    bundle.push(SERVO_TOPIC, Schema::ServoAnswer, answer);
    let grasps = answer.grasp.as_slice();
    let world = frame.world_frame_id.clone().unwrap_or_else(|| "world".to_owned());
    let shown = Shown { world, plan_id: "", hand: Some(hand), grasps };
    poses(bundle, "/servo/poses".to_owned(), &shown);
    scene(bundle, "/servo/scene".to_owned(), &shown);
    cloud::cloud(bundle, "/servo/points".to_owned(), &shown);
}

/// Grasps, best first, and what they are shown with.
struct Shown<'a> {
    /// The frame that their poses are in.
    world: String,
    plan_id: &'a str,
    hand: Option<&'a Hand>,
    grasps: &'a [v1::Grasp],
}

/// A task's name as part of a topic.
fn topic_name(task_id: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    task_id.chars().take(64).map(plain).collect()
}

/// What one camera saw, under the topics that begin with `base`; `has_raw` if raw pixels are in the bundle already.
fn camera(bundle: &mut Bundle, base: &str, encoded: &EncodedFrame, has_raw: bool) {
    let topic = |name: &str| format!("{base}/{name}");
    let timestamp = Some(bundle.timestamp());
    let frame_id = encoded.camera_frame_id.clone();
    // Raw pixels are shown exactly as they were sent, those of a PNG in metres.
    let raw = encoded.raw_pixels();
    if let (Some(raw), false) = (&raw, has_raw) {
        bundle.add(topic("depth"), Schema::RawImage, || foxglove::RawImage {
            timestamp,
            frame_id: frame_id.clone(),
            width: fixed(raw.width),
            height: fixed(raw.height),
            encoding: raw.encoding.to_owned(),
            step: fixed(raw.width).saturating_mul(raw.pixel_bytes),
            data: raw.data.clone(),
        });
    }
    let is_png = raw.is_none();
    let wants_depth = is_png && bundle.wants(&topic("depth"), Schema::RawImage);
    let wants_calibration = bundle.wants(&topic("calibration"), Schema::CameraCalibration);
    let wants_points = bundle.wants(&topic("points"), Schema::PointCloud);
    transform(bundle, encoded);
    if !(wants_depth || wants_calibration || wants_points) {
        return;
    }
    let Ok((frame, _)) = encoded.decode() else { return };
    let (image, lens) = (&frame.image, &frame.intrinsics);
    let (width, height) = (fixed(image.width), fixed(image.height));
    bundle.add(topic("calibration"), Schema::CameraCalibration, || {
        let used = if lens.distortion[5..].iter().any(|k| *k != 0.0) { 8 } else { 5 };
        foxglove::CameraCalibration {
            timestamp,
            frame_id: frame_id.clone(),
            width,
            height,
            distortion_model: if used == 8 { "rational_polynomial" } else { "plumb_bob" }.to_owned(),
            d: lens.distortion.into_iter().take(used).collect(),
            k: vec![lens.fx_px, 0.0, lens.cx_px, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 1.0],
            r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: vec![lens.fx_px, 0.0, lens.cx_px, 0.0, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0],
        }
    });
    if is_png {
        bundle.add(topic("depth"), Schema::RawImage, || foxglove::RawImage {
            timestamp,
            frame_id: frame_id.clone(),
            width,
            height,
            encoding: "32FC1".to_owned(),
            step: width.saturating_mul(4),
            data: image.depth_m.iter().flat_map(|d| d.to_le_bytes()).collect::<Vec<u8>>().into(),
        });
    }
    let float = foxglove::packed_element_field::NumericType::Float32;
    bundle.add(topic("points"), Schema::PointCloud, || foxglove::PointCloud {
        timestamp,
        frame_id: frame_id.clone(),
        pose: Some(pose_message(&Isometry3::identity())),
        point_stride: 12,
        fields: vec![field("x", 0, float), field("y", 4, float), field("z", 8, float)],
        data: points(&frame),
    });
}

/// Where a camera stood, where the caller has said so.
fn transform(bundle: &mut Bundle, encoded: &EncodedFrame) {
    let (Some(pose), Some(world)) = (&encoded.world_from_camera, &encoded.world_frame_id) else { return };
    if *world == encoded.camera_frame_id {
        return;
    }
    let foxglove::Pose { position, orientation } = pose_message(pose);
    let transform = foxglove::FrameTransform {
        timestamp: Some(bundle.timestamp()),
        parent_frame_id: world.clone(),
        child_frame_id: encoded.camera_frame_id.clone(),
        translation: position,
        rotation: orientation,
    };
    bundle.push("/tf", Schema::FrameTransform, &transform);
}

/// Points in the camera's frame, three floats each: every pixel of a picture that is small, a grid of a large one.
fn points(frame: &Frame) -> Vec<u8> {
    let image = &frame.image;
    let stride = (1..).find(|s| image.width.div_ceil(*s) * image.height.div_ceil(*s) <= MOST_POINTS);
    let stride = stride.unwrap_or(1);
    let mut data = Vec::new();
    for (row, depths) in image.depth_m.chunks(image.width.max(1)).enumerate().step_by(stride) {
        for (column, &depth) in depths.iter().enumerate().step_by(stride) {
            let pixel = [column as f64, row as f64];
            if let (true, Some([x, y])) = (depth > 0.0 && depth.is_finite(), frame.intrinsics.ray(pixel)) {
                for value in [(x * f64::from(depth)) as f32, (y * f64::from(depth)) as f32, depth] {
                    data.extend(value.to_le_bytes());
                }
            }
        }
    }
    data
}

/// The wrist at each grasp.
fn poses(bundle: &mut Bundle, topic: String, shown: &Shown<'_>) {
    let timestamp = Some(bundle.timestamp());
    bundle.add(topic, Schema::PosesInFrame, || {
        let placed = shown.grasps.iter().filter_map(|g| placed(g.wrist_pose.as_ref()));
        let poses = placed.map(|pose| pose_message(&pose)).collect();
        foxglove::PosesInFrame { timestamp, frame_id: shown.world.clone(), poses }
    });
}

/// Grasps as arrows, the best one's contacts, and the hand at that grasp and before it. What the call before drew goes.
fn scene(bundle: &mut Bundle, topic: String, shown: &Shown<'_>) {
    let timestamp = bundle.timestamp();
    bundle.add(topic, Schema::SceneUpdate, || scene_update(timestamp, shown));
}

fn scene_update(timestamp: prost_types::Timestamp, shown: &Shown<'_>) -> foxglove::SceneUpdate {
    let (timestamp, hand) = (Some(timestamp), shown.hand);
    let entity = |id: &str| foxglove::SceneEntity {
        timestamp,
        frame_id: shown.world.clone(),
        id: id.to_owned(),
        ..Default::default()
    };
    let deletion = foxglove::SceneEntityDeletion {
        timestamp,
        r#type: foxglove::scene_entity_deletion::Type::All.into(),
        id: String::new(),
    };
    let mut entities = Vec::new();
    let mut arrows = entity("grasps");
    arrows.metadata = vec![pair("plan_id", shown.plan_id)];
    // The worst first: the best is drawn over it.
    for (i, grasp) in shown.grasps.iter().enumerate().rev() {
        let Some(world_from_hand) = placed(grasp.wrist_pose.as_ref()) else { continue };
        let (tip, direction, length) = approach_line(&world_from_hand, hand);
        // An arrow points along its own x.
        let turn = UnitQuaternion::rotation_between(&Vector3::x(), &direction);
        let turn =
            turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
        let pose = Isometry3::from_parts(Translation3::from(tip.coords - direction * length), turn);
        arrows.arrows.push(foxglove::ArrowPrimitive {
            pose: Some(pose_message(&pose)),
            shaft_length: length - 0.015,
            shaft_diameter: if i == 0 { 0.006 } else { 0.003 },
            head_length: 0.015,
            head_diameter: if i == 0 { 0.014 } else { 0.008 },
            color: Some(score_color(grasp, shown.grasps)),
        });
        arrows.metadata.push(pair(&format!("score[{i}]"), &format!("{:.4}", grasp.score)));
    }
    entities.push(arrows);
    if let Some(best) = shown.grasps.first() {
        let mut contacts = entity("contacts of the best");
        for point in best.contacts.iter().filter_map(|c| c.point.as_ref()) {
            let pose = Isometry3::translation(point.x, point.y, point.z);
            contacts.spheres.push(foxglove::SpherePrimitive {
                pose: Some(pose_message(&pose)),
                size: Some(foxglove::Vector3 { x: 0.008, y: 0.008, z: 0.008 }),
                color: Some(CONTACT),
            });
        }
        entities.push(contacts);
        let joints = best.joints.clone().unwrap_or_default();
        let drawn = [
            ("hand at contact", &best.wrist_pose, &joints.contact, AT_CONTACT),
            ("hand at pre-grasp", &best.pregrasp_pose, &joints.open, AT_PREGRASP),
        ];
        for (id, pose, joints, color) in drawn {
            if let (Some(hand), Some(pose)) = (hand, placed(pose.as_ref()))
                && joints.len() == hand.tree.joints.len()
            {
                let mut shown = entity(id);
                hand_shapes(&mut shown, hand, &pose, joints, &color);
                entities.push(shown);
            }
        }
    }
    foxglove::SceneUpdate { deletions: vec![deletion], entities }
}

fn hand_shapes(
    entity: &mut foxglove::SceneEntity,
    hand: &Hand,
    world_from_hand: &Isometry3<f64>,
    joints: &[f64],
    color: &foxglove::Color,
) {
    for (shape, pose) in placed_shapes(hand, world_from_hand, joints) {
        let (pose, color) = (Some(pose_message(&pose)), Some(*color));
        let size = |x: f64, y: f64, z: f64| Some(foxglove::Vector3 { x: 2.0 * x, y: 2.0 * y, z: 2.0 * z });
        match shape {
            Shape::Box { half_extents: h } => {
                entity.cubes.push(foxglove::CubePrimitive { pose, size: size(h.x, h.y, h.z), color });
            }
            &Shape::Sphere { radius } => {
                let size = size(radius, radius, radius);
                entity.spheres.push(foxglove::SpherePrimitive { pose, size, color });
            }
            &Shape::Cylinder { radius, half_length } => {
                entity.cylinders.push(foxglove::CylinderPrimitive {
                    pose,
                    size: size(radius, radius, half_length),
                    bottom_scale: 1.0,
                    top_scale: 1.0,
                    color,
                });
            }
            Shape::Mesh { vertices, triangles } => {
                let points = vertices.iter().map(|v| foxglove::Point3 { x: v.x, y: v.y, z: v.z }).collect();
                let indices = triangles.iter().flatten().copied().collect();
                let list = foxglove::TriangleListPrimitive { pose, points, color, colors: vec![], indices };
                entity.triangles.push(list);
            }
        }
    }
}

/// What a hand is drawn with.
fn shapes(hand: &Hand) -> &[CollisionShape] {
    let triangles = |shape: &CollisionShape| match &shape.shape {
        Shape::Mesh { triangles, .. } => triangles.len(),
        _ => 0,
    };
    match hand.visuals.is_empty() || hand.visuals.iter().map(triangles).sum::<usize>() > MOST_TRIANGLES {
        true => &hand.collision,
        false => &hand.visuals,
    }
}

/// What a hand in a posture is drawn with, each shape with its pose in the world.
fn placed_shapes<'a>(
    hand: &'a Hand,
    world_from_hand: &Isometry3<f64>,
    joints: &[f64],
) -> impl Iterator<Item = (&'a Shape, Isometry3<f64>)> {
    let (bodies, world_from_hand) = (hand.tree.body_poses(joints), *world_from_hand);
    shapes(hand).iter().filter_map(move |shape| {
        let link = hand.tree.links.get(shape.link)?;
        let body = bodies.get(link.body)?;
        Some((&shape.shape, world_from_hand * body * link.body_from_link * shape.link_from_shape))
    })
}

/// A grasp as a line: where the tool point is, the way it came, and how long it is drawn, metres.
fn approach_line(world_from_hand: &Isometry3<f64>, hand: Option<&Hand>) -> (Point3<f64>, Vector3<f64>, f64) {
    let approach = hand.map_or(Vector3::z_axis(), |hand| hand.approach);
    let tool = hand.map_or(Vector3::zeros(), |hand| hand.tool_point.coords);
    (world_from_hand * Point3::from(tool), world_from_hand.rotation * approach.into_inner(), 0.06)
}

/// Green for the best, red for nothing.
fn score_color(grasp: &v1::Grasp, all: &[v1::Grasp]) -> foxglove::Color {
    let best = all.first().map_or(1.0, |g| g.uncalibrated_score).max(1e-9);
    let share = (grasp.uncalibrated_score / best).clamp(0.0, 1.0);
    foxglove::Color { r: 1.0 - share, g: 0.3 + 0.6 * share, b: 0.15, a: 0.9 }
}

fn field(
    name: &str,
    offset: u32,
    kind: foxglove::packed_element_field::NumericType,
) -> foxglove::PackedElementField {
    foxglove::PackedElementField { name: name.to_owned(), offset, r#type: kind.into() }
}

/// The frame that an answer's poses are in.
fn world(answer: &v1::PlanGraspsResponse) -> String {
    let of_grasp = answer.grasps.first().and_then(|g| g.wrist_pose.as_ref());
    let of_volume = answer.workspace.as_ref().and_then(|w| w.pose.as_ref());
    of_grasp.or(of_volume).map_or_else(|| "world".to_owned(), |pose| pose.frame_id.clone())
}

/// A pose of an answer.
fn placed(pose: Option<&v1::PoseInFrame>) -> Option<Isometry3<f64>> {
    let v1::Pose { position, orientation } = pose?.pose.as_ref()?;
    let (p, q) = (position.as_ref()?, orientation.as_ref()?);
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
    Some(Isometry3::from_parts(Translation3::new(p.x, p.y, p.z), turn))
}

fn pose_message(pose: &Isometry3<f64>) -> foxglove::Pose {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    foxglove::Pose {
        position: Some(foxglove::Vector3 { x: t.x, y: t.y, z: t.z }),
        orientation: Some(foxglove::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    }
}

fn pair(key: &str, value: &str) -> foxglove::KeyValuePair {
    foxglove::KeyValuePair { key: key.to_owned(), value: value.to_owned() }
}

fn fixed(side: usize) -> u32 {
    u32::try_from(side).unwrap_or(u32::MAX)
}

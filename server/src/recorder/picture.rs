//! A call as viewers show it: depth, lens and place of each camera, its points, grasps and the hand that takes the
//! best of them.

use std::sync::Arc;

use graspd_hands::{CollisionShape, Hand, Shape};
use graspd_planner::frame::Frame;
use graspd_proto::v1;
use graspd_proto::v1::hand_task_result::Outcome;
use graspd_proto::v1::plan_record::Request;
use graspd_recording::{Bundle, STATS_TOPIC, Schema, depth_topic, foxglove};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::convert::EncodedFrame;

/// Points of a camera that are drawn.
const MOST_POINTS: usize = 40_000;
/// A hand with more triangles is drawn by its collision shapes.
const MOST_TRIANGLES: usize = 20_000;
/// The hand where it touches, and where it comes from.
const AT_CONTACT: foxglove::Color = foxglove::Color { r: 0.25, g: 0.5, b: 0.9, a: 0.9 };
const AT_PREGRASP: foxglove::Color = foxglove::Color { r: 0.6, g: 0.6, b: 0.6, a: 0.25 };
const CONTACT: foxglove::Color = foxglove::Color { r: 0.95, g: 0.75, b: 0.1, a: 1.0 };

/// Everything that is written of a call.
pub(super) fn bundle(time_ns: u64, record: v1::PlanRecord, hands: &[Arc<Hand>]) -> Bundle {
    let mut bundle = Bundle::at(time_ns);
    let frames = match &record.request {
        Some(Request::PlanGrasps(plan)) => plan.frames.clone(),
        Some(Request::PlanMultiHand(plan)) => plan.frames.clone(),
        None => Vec::new(),
    };
    let results = record.results.clone();
    bundle.push_plan(record);
    for (i, wire) in frames.into_iter().enumerate() {
        let is_png = wire.encoding() == v1::DepthEncoding::PngU16;
        // A frame that cannot be decoded was refused; what was sent is there all the same.
        let Ok(encoded) = EncodedFrame::parse(wire, String::new()) else { continue };
        let Ok((frame, _)) = encoded.decode() else { continue };
        camera(&mut bundle, i, &encoded, &frame, is_png);
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
        poses(&mut bundle, topic("poses"), answer);
        scene(&mut bundle, topic("scene"), answer, hand.map(Arc::as_ref));
    }
    bundle
}

/// A task's name as part of a topic.
fn topic_name(task_id: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    task_id.chars().take(64).map(plain).collect()
}

/// What one camera saw.
fn camera(bundle: &mut Bundle, i: usize, encoded: &EncodedFrame, frame: &Frame, is_png: bool) {
    let timestamp = Some(bundle.timestamp());
    let frame_id = encoded.camera_frame_id.clone();
    let (image, lens) = (&frame.image, &frame.intrinsics);
    let (width, height) = (fixed(image.width), fixed(image.height));
    if is_png {
        // Raw pixels are there already, exactly as they were sent.
        let metres = image.depth_m.iter().flat_map(|d| d.to_le_bytes());
        let image = foxglove::RawImage {
            timestamp,
            frame_id: frame_id.clone(),
            width,
            height,
            encoding: "32FC1".to_owned(),
            step: width.saturating_mul(4),
            data: metres.collect(),
        };
        bundle.push(depth_topic(i), Schema::RawImage, &image);
    }
    let distortion = lens.distortion;
    let used = if lens.distortion[5..].iter().any(|k| *k != 0.0) { 8 } else { 5 };
    let calibration = foxglove::CameraCalibration {
        timestamp,
        frame_id: frame_id.clone(),
        width,
        height,
        distortion_model: if used == 8 { "rational_polynomial" } else { "plumb_bob" }.to_owned(),
        d: distortion.into_iter().take(used).collect(),
        k: vec![lens.fx_px, 0.0, lens.cx_px, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![lens.fx_px, 0.0, lens.cx_px, 0.0, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0],
    };
    bundle.push(format!("/camera/{i}/calibration"), Schema::CameraCalibration, &calibration);
    if let (Some(pose), Some(world)) = (&encoded.world_from_camera, &encoded.world_frame_id)
        && *world != frame_id
    {
        let foxglove::Pose { position, orientation } = pose_message(pose);
        let transform = foxglove::FrameTransform {
            timestamp,
            parent_frame_id: world.clone(),
            child_frame_id: frame_id.clone(),
            translation: position,
            rotation: orientation,
        };
        bundle.push("/tf", Schema::FrameTransform, &transform);
    }
    let field = |name: &str, offset| foxglove::PackedElementField {
        name: name.to_owned(),
        offset,
        r#type: foxglove::packed_element_field::NumericType::Float32.into(),
    };
    let points = foxglove::PointCloud {
        timestamp,
        frame_id,
        pose: Some(pose_message(&Isometry3::identity())),
        point_stride: 12,
        fields: vec![field("x", 0), field("y", 4), field("z", 8)],
        data: points(frame),
    };
    bundle.push(format!("/camera/{i}/points"), Schema::PointCloud, &points);
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
fn poses(bundle: &mut Bundle, topic: String, answer: &v1::PlanGraspsResponse) {
    let placed: Vec<_> = answer.grasps.iter().filter_map(|g| placed(g.wrist_pose.as_ref())).collect();
    let message = foxglove::PosesInFrame {
        timestamp: Some(bundle.timestamp()),
        frame_id: world(answer),
        poses: placed.iter().map(pose_message).collect(),
    };
    bundle.push(topic, Schema::PosesInFrame, &message);
}

/// Grasps as arrows, the best one's contacts, and the hand at that grasp and before it. What the call before drew goes.
fn scene(bundle: &mut Bundle, topic: String, answer: &v1::PlanGraspsResponse, hand: Option<&Hand>) {
    let timestamp = Some(bundle.timestamp());
    let entity = |id: &str| foxglove::SceneEntity {
        timestamp,
        frame_id: world(answer),
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
    let best_score = answer.grasps.first().map_or(1.0, |g| g.uncalibrated_score).max(1e-9);
    arrows.metadata = vec![pair("plan_id", &answer.plan_id)];
    // The worst first: the best is drawn over it.
    for (i, grasp) in answer.grasps.iter().enumerate().rev() {
        let Some(world_from_hand) = placed(grasp.wrist_pose.as_ref()) else { continue };
        let approach = hand.map_or(Vector3::z_axis(), |hand| hand.approach);
        let tool = hand.map_or(Vector3::zeros(), |hand| hand.tool_point.coords);
        let length = 0.06;
        let tip = world_from_hand * nalgebra::Point3::from(tool);
        let direction = world_from_hand.rotation * approach.into_inner();
        // An arrow points along its own x.
        let turn = UnitQuaternion::rotation_between(&Vector3::x(), &direction);
        let turn =
            turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
        let pose = Isometry3::from_parts(Translation3::from(tip.coords - direction * length), turn);
        let share = (grasp.uncalibrated_score / best_score).clamp(0.0, 1.0);
        arrows.arrows.push(foxglove::ArrowPrimitive {
            pose: Some(pose_message(&pose)),
            shaft_length: length - 0.015,
            shaft_diameter: if i == 0 { 0.006 } else { 0.003 },
            head_length: 0.015,
            head_diameter: if i == 0 { 0.014 } else { 0.008 },
            color: Some(foxglove::Color { r: 1.0 - share, g: 0.3 + 0.6 * share, b: 0.15, a: 0.9 }),
        });
        arrows.metadata.push(pair(&format!("score[{i}]"), &format!("{:.4}", grasp.score)));
    }
    entities.push(arrows);
    if let Some(best) = answer.grasps.first() {
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
    let update = foxglove::SceneUpdate { deletions: vec![deletion], entities };
    bundle.push(topic, Schema::SceneUpdate, &update);
}

fn hand_shapes(
    entity: &mut foxglove::SceneEntity,
    hand: &Hand,
    world_from_hand: &Isometry3<f64>,
    joints: &[f64],
    color: &foxglove::Color,
) {
    let triangles = |shapes: &[CollisionShape]| -> usize {
        shapes
            .iter()
            .map(|s| if let Shape::Mesh { triangles, .. } = &s.shape { triangles.len() } else { 0 })
            .sum()
    };
    let shapes = match hand.visuals.is_empty() || triangles(&hand.visuals) > MOST_TRIANGLES {
        true => &hand.collision,
        false => &hand.visuals,
    };
    let bodies = hand.tree.body_poses(joints);
    for shape in shapes {
        let Some(link) = hand.tree.links.get(shape.link) else { continue };
        let Some(body) = bodies.get(link.body) else { continue };
        let pose = world_from_hand * body * link.body_from_link * shape.link_from_shape;
        let (pose, color) = (Some(pose_message(&pose)), Some(*color));
        let size = |x: f64, y: f64, z: f64| Some(foxglove::Vector3 { x: 2.0 * x, y: 2.0 * y, z: 2.0 * z });
        match &shape.shape {
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

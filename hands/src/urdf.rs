//! Reading an untrusted URDF into a kinematic tree and shapes.
//!
//! Parsing is left to `urdf-rs`; everything before it (size, depth, entities) and after it (one tree,
//! sane numbers, known joint types, mesh names that stay in the folder) is checked here.

use std::collections::HashMap;

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::error::Findings;
use crate::files::URDF;
use crate::joint_limits::{self, Stated};
use crate::{Body, CollisionShape, HandFiles, Joint, JointKind, Link, Tree, geometry, xml_guard};

/// Most links of a hand.
pub(crate) const MAX_LINKS: usize = 128;
/// No length of a hand is larger than this, metres.
pub(crate) const MAX_LENGTH_M: f64 = 2.0;
/// Most shapes of the hand.
const MAX_ALL_SHAPES: usize = 512;

/// A joint that follows another: `q = multiplier·q[joint] + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mimic {
    /// Index into the tree's joints.
    pub(crate) joint: usize,
    pub(crate) multiplier: f64,
    pub(crate) offset: f64,
}

/// What a URDF says about a hand.
#[derive(Debug, Clone)]
pub(crate) struct Model {
    pub(crate) tree: Tree,
    /// Per movable joint, its mimic tag.
    pub(crate) mimics: Vec<Option<Mimic>>,
    pub(crate) collision: Vec<CollisionShape>,
    pub(crate) visuals: Vec<CollisionShape>,
}

/// A link in the order of the tree, with its parent link and the joint that leads to it; `None` for the
/// root. All are indices in the document.
type Step = (usize, Option<(usize, usize)>);

/// Reads `hand.urdf`. `None` when errors were recorded.
pub(crate) fn read(bytes: &[u8], files: &HandFiles, findings: &mut Findings) -> Option<Model> {
    let Ok(text) = std::str::from_utf8(bytes) else {
        findings.error(URDF, "text", "bytes that are not UTF-8", "a UTF-8 text");
        return None;
    };
    if text.contains('\0') {
        findings.error(URDF, "text", "zero bytes: not UTF-8, perhaps UTF-16", "a UTF-8 text");
        return None;
    }
    if let Err((found, expected)) = xml_guard::check(text) {
        findings.error(URDF, "document", found, expected);
        return None;
    }
    let robot = match urdf_rs::read_from_string(text) {
        Ok(robot) => robot,
        Err(error) => {
            findings.error(URDF, "document", error, "a URDF <robot>");
            return None;
        }
    };
    if robot.links.is_empty() || robot.links.len() > MAX_LINKS {
        findings.error(URDF, "links", robot.links.len(), format!("1 to {MAX_LINKS} links"));
        return None;
    }
    if robot.joints.len() >= MAX_LINKS {
        findings.error(URDF, "joints", robot.joints.len(), format!("fewer than {MAX_LINKS} joints"));
        return None;
    }
    let links = names(robot.links.iter().map(|l| l.name.as_str()), "link", findings);
    let joints = names(robot.joints.iter().map(|j| j.name.as_str()), "joint", findings);
    let order = order(&robot, &links, findings);
    let stated = joint_limits::stated(text);
    let joint_motions: Vec<Option<Joint>> = robot
        .joints
        .iter()
        .enumerate()
        .map(|(i, j)| joint(j, stated.get(i).copied().unwrap_or_default(), findings))
        .collect();
    let origins: Vec<Isometry3<f64>> = robot
        .joints
        .iter()
        .map(|j| pose(&j.origin, &format!("joint {:?} origin", j.name), findings))
        .collect();
    if !findings.ok() {
        return None;
    }
    let (tree, joint_index) = tree(&robot, &order?, &joint_motions, &origins);
    let mimics = mimics(&robot, &joints, &joint_index, &tree, findings);
    let (collision, visuals) = geometry::read(&robot, &tree, files, findings);
    if collision.len() > MAX_ALL_SHAPES || visuals.len() > 2 * MAX_ALL_SHAPES {
        findings.error(
            URDF,
            "links",
            format!("{} collision and {} visual shapes", collision.len(), visuals.len()),
            format!("at most {MAX_ALL_SHAPES} collision shapes and twice as many visual ones"),
        );
    }
    findings.ok().then_some(Model { tree, mimics, collision, visuals })
}

/// Index by name; duplicates and empty names are errors.
fn names<'a>(
    all: impl Iterator<Item = &'a str>,
    what: &str,
    findings: &mut Findings,
) -> HashMap<&'a str, usize> {
    let mut index = HashMap::new();
    for (i, name) in all.enumerate() {
        if name.is_empty() || name.len() > 128 {
            findings.error(URDF, format!("{what} {i} name"), format!("{name:?}"), "1 to 128 characters");
        }
        if index.insert(name, i).is_some() {
            findings.error(URDF, format!("{what} {name:?}"), "the name twice", "unique names");
        }
    }
    index
}

/// Links in depth-first order with the joint (index in the document) that leads to each.
fn order(robot: &urdf_rs::Robot, links: &HashMap<&str, usize>, findings: &mut Findings) -> Option<Vec<Step>> {
    let mut parent_joint: Vec<Option<usize>> = vec![None; robot.links.len()];
    let mut children: Vec<Vec<(usize, usize)>> = vec![Vec::new(); robot.links.len()];
    let before = findings.errors.len();
    for (j, joint) in robot.joints.iter().enumerate() {
        let mut end = |role: &str, name: &str| {
            let found = links.get(name).copied();
            if found.is_none() {
                findings.error(
                    URDF,
                    format!("joint {:?} {role}", joint.name),
                    format!("unknown link {name:?}"),
                    "the name of a <link>",
                );
            }
            found
        };
        let (parent, child) = (end("parent", &joint.parent.link), end("child", &joint.child.link));
        let (Some(parent), Some(child)) = (parent, child) else { continue };
        if let Some(other) = parent_joint[child].replace(j) {
            findings.error(
                URDF,
                format!("link {:?}", joint.child.link),
                format!("two parents, by joints {:?} and {:?}", robot.joints[other].name, joint.name),
                "one parent: a hand is a tree",
            );
        }
        children[parent].push((child, j));
    }
    let roots: Vec<usize> = (0..robot.links.len()).filter(|&l| parent_joint[l].is_none()).collect();
    let &[root] = roots.as_slice() else {
        let list: Vec<&str> = roots.iter().take(8).map(|&r| robot.links[r].name.as_str()).collect();
        findings.error(
            URDF,
            "links",
            format!("{} root links {list:?}", roots.len()),
            "exactly one link without a parent (none: the joints form a cycle)",
        );
        return None;
    };
    if findings.errors.len() > before {
        return None;
    }
    let mut order = Vec::with_capacity(robot.links.len());
    let mut stack = vec![(root, None)];
    while let Some((link, from)) = stack.pop() {
        order.push((link, from));
        stack.extend(children[link].iter().rev().map(|&(child, j)| (child, Some((link, j)))));
    }
    if order.len() != robot.links.len() {
        findings.error(
            URDF,
            "joints",
            format!("{} of {} links reachable from the root", order.len(), robot.links.len()),
            "one tree without cycles",
        );
        return None;
    }
    Some(order)
}

/// A movable joint; `None` for a fixed one or after an error.
fn joint(joint: &urdf_rs::Joint, stated: Stated, findings: &mut Findings) -> Option<Joint> {
    use urdf_rs::JointType;
    let field = |what: &str| format!("joint {:?} {what}", joint.name);
    let kind = match joint.joint_type {
        JointType::Fixed => return None,
        JointType::Revolute | JointType::Continuous => JointKind::Revolute,
        JointType::Prismatic => JointKind::Prismatic,
        JointType::Floating | JointType::Planar | JointType::Spherical => {
            findings.error(
                URDF,
                field("type"),
                format!("{:?}", joint.joint_type),
                "fixed, revolute, continuous or prismatic",
            );
            return None;
        }
    };
    let axis = Vector3::from(joint.axis.xyz.0);
    let norm = axis.norm();
    if !(norm.is_finite() && norm > 1e-6) {
        findings.error(
            URDF,
            field("axis"),
            format!("{:?}", joint.axis.xyz.0),
            "a finite axis other than zero",
        );
        return None;
    }
    if (norm - 1.0).abs() > 1e-3 {
        findings.warn(URDF, field("axis"), format!("length {norm:.4}"), "a unit axis (it was normalized)");
    }
    let limit = &joint.limit;
    let (mut lower, mut upper) = (limit.lower, limit.upper);
    let none = lower == upper || !(lower.is_finite() && upper.is_finite());
    if joint.joint_type == JointType::Continuous && none {
        (lower, upper) = (-std::f64::consts::PI, std::f64::consts::PI);
        findings.warn(
            URDF,
            field("limit"),
            "a continuous joint, which has none",
            "type revolute with the limits of the real joint (-π to π were assumed)",
        );
    }
    if joint.joint_type != JointType::Continuous && !limits_stated(stated, &field("limit"), findings) {
        return None;
    }
    let most = if kind == JointKind::Revolute { 4.0 * std::f64::consts::PI } else { MAX_LENGTH_M };
    if !(lower < upper && lower.abs() <= most && upper.abs() <= most) {
        findings.error(
            URDF,
            field("limit"),
            format!("lower {lower}, upper {upper}"),
            format!("lower < upper, both finite and within ±{most:.1}"),
        );
        return None;
    }
    let rate = |value: f64| if value.is_finite() && value > 0.0 { value } else { 0.0 };
    Some(Joint {
        name: joint.name.clone(),
        kind,
        axis: Unit::new_normalize(axis),
        lower,
        upper,
        effort: rate(limit.effort),
        velocity: rate(limit.velocity),
    })
}

/// True with an upper limit. The lower one may be left out: URDF then takes it to be zero.
fn limits_stated(stated: Stated, field: &str, findings: &mut Findings) -> bool {
    const EXPECTED: &str = "<limit lower=\"…\" upper=\"…\"/>: radians, or metres if prismatic";
    if !stated.limit {
        findings.error(URDF, field, "no <limit>", EXPECTED);
        return false;
    }
    if !stated.upper {
        let both = if stated.lower { "a <limit> without upper" } else { "a <limit> without lower and upper" };
        findings.error(URDF, field, both, EXPECTED);
        return false;
    }
    if !stated.lower {
        findings.warn(URDF, field, "a <limit> without lower", "both limits (0 was assumed, as URDF says)");
    }
    true
}

/// A pose with bounded numbers; identity after an error.
pub(crate) fn pose(pose: &urdf_rs::Pose, field: &str, findings: &mut Findings) -> Isometry3<f64> {
    let (xyz, rpy) = (pose.xyz.0, pose.rpy.0);
    if !xyz.iter().all(|v| v.is_finite() && v.abs() <= MAX_LENGTH_M) {
        findings.error(URDF, format!("{field} xyz"), format!("{xyz:?}"), "finite metres within ±2");
        return Isometry3::identity();
    }
    if !rpy.iter().all(|v| v.is_finite() && v.abs() <= 100.0) {
        findings.error(URDF, format!("{field} rpy"), format!("{rpy:?}"), "finite radians");
        return Isometry3::identity();
    }
    Isometry3::from_parts(
        Translation3::from(xyz),
        // URDF: fixed-axis roll, pitch, yaw; the same convention as nalgebra's.
        UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
    )
}

/// The tree, and for each joint of the document its index among the movable ones.
fn tree(
    robot: &urdf_rs::Robot,
    order: &[Step],
    motions: &[Option<Joint>],
    origins: &[Isometry3<f64>],
) -> (Tree, Vec<Option<usize>>) {
    let mut place = vec![0; robot.links.len()];
    let mut joint_index = vec![None; robot.joints.len()];
    let root = Body { parent: None, parent_from_joint: Isometry3::identity(), joint: None };
    let mut tree = Tree { links: Vec::new(), joints: Vec::new(), bodies: vec![root] };
    for &(link, from) in order {
        place[link] = tree.links.len();
        let (parent, body, body_from_link) = match from {
            None => (None, 0, Isometry3::identity()),
            Some((parent, j)) => {
                let parent = place[parent];
                let (carrier, carrier_from_joint) = {
                    let p: &Link = &tree.links[parent];
                    (p.body, p.body_from_link * origins[j])
                };
                match &motions[j] {
                    None => (Some(parent), carrier, carrier_from_joint),
                    Some(joint) => {
                        joint_index[j] = Some(tree.joints.len());
                        tree.bodies.push(Body {
                            parent: Some(carrier),
                            parent_from_joint: carrier_from_joint,
                            joint: Some(tree.joints.len()),
                        });
                        tree.joints.push(joint.clone());
                        (Some(parent), tree.bodies.len() - 1, Isometry3::identity())
                    }
                }
            }
        };
        tree.links.push(Link { name: robot.links[link].name.clone(), body, body_from_link, parent });
    }
    (tree, joint_index)
}

/// Mimic tags of the movable joints.
fn mimics(
    robot: &urdf_rs::Robot,
    joints: &HashMap<&str, usize>,
    joint_index: &[Option<usize>],
    tree: &Tree,
    findings: &mut Findings,
) -> Vec<Option<Mimic>> {
    let mut out = vec![None; tree.joints.len()];
    for (joint, index) in robot.joints.iter().zip(joint_index) {
        let (Some(tag), Some(index)) = (&joint.mimic, *index) else { continue };
        let field = format!("joint {:?} mimic", joint.name);
        let (multiplier, offset) = (tag.multiplier.unwrap_or(1.0), tag.offset.unwrap_or(0.0));
        if !(multiplier.is_finite() && multiplier.abs() <= 1e3 && offset.is_finite() && offset.abs() <= 1e3) {
            findings.error(
                URDF,
                &field,
                format!("multiplier {multiplier}, offset {offset}"),
                "finite numbers",
            );
            continue;
        }
        match joints.get(tag.joint.as_str()).and_then(|&j| joint_index[j]) {
            Some(joint) => out[index] = Some(Mimic { joint, multiplier, offset }),
            None => findings.error(URDF, &field, format!("{:?}", tag.joint), "the name of a movable joint"),
        }
    }
    for start in 0..out.len() {
        let mut at = start;
        for _ in 0..=out.len() {
            match out[at] {
                Some(Mimic { joint, .. }) => at = joint,
                None => break,
            }
        }
        if out[at].is_some() {
            findings.error(
                URDF,
                format!("joint {:?} mimic", tree.joints[start].name),
                "a chain of mimic tags that never ends",
                "a chain that ends at a joint without one",
            );
            break;
        }
    }
    out
}

//! A validated hand: all that the planner, the server and the drawings need to know.

use std::fmt;

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::{Actuation, CollisionShape, CollisionSphere, Confidence, ContactCandidate, Pad, Tree};

/// A finger: a name for a group of pads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finger {
    /// Name, unique in the hand.
    pub name: String,
}

/// How far a hand opens between opposed pads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opening {
    /// Smallest distance between opposed pads, metres.
    pub min_m: f64,
    /// Largest distance between opposed pads, metres: the widest object the hand can straddle.
    pub max_m: f64,
}

/// A hand, ready to be planned for. Immutable: a change is a new hand with a new revision.
#[derive(Debug, Clone, PartialEq)]
pub struct Hand {
    /// Resource id, `[a-z][a-z0-9-]{0,62}`, for example `leap`.
    pub id: String,
    /// Shown to people.
    pub display_name: String,
    /// Changes with every change of the files (a hash of their contents, hexadecimal).
    pub revision: String,
    /// Kinematics.
    pub tree: Tree,
    /// Coordinates to joints.
    pub actuation: Actuation,
    /// Approach direction `v_sa` in the hand frame: the hand reaches for objects along it.
    pub approach: Unit<Vector3<f64>>,
    /// Tool point in the hand frame: between the pads with the hand half closed, metres.
    pub tool_point: Point3<f64>,
    /// Back-off of the initial pose along the approach, metres (Supplementary Note 4: 0.05).
    pub start_offset_m: f64,
    /// Fingers.
    pub fingers: Vec<Finger>,
    /// Contact pads.
    pub pads: Vec<Pad>,
    /// Contact candidates, sampled on the pads.
    pub candidates: Vec<ContactCandidate>,
    /// Shapes for collision checks.
    pub collision: Vec<CollisionShape>,
    /// Shapes for drawing; the collision shapes where the URDF has no visuals that can be loaded.
    pub visuals: Vec<CollisionShape>,
    /// Sphere covering of the collision shapes.
    pub spheres: Vec<CollisionSphere>,
    /// Pairs of spheres (indices) of different bodies that can come to overlap and do not in the open
    /// posture: those that self-collision must check.
    pub self_pairs: Vec<(usize, usize)>,
    /// How far the hand opens, where two pads oppose each other.
    pub opening: Option<Opening>,
    /// What a grasp's figure says about its success with this hand.
    pub confidence: Confidence,
    /// Things worth a look that are not errors.
    pub warnings: Vec<String>,
}

impl Hand {
    /// Largest distance from the tool point to any sphere of the hand with the fingers open, metres.
    pub fn reach_m(&self) -> f64 {
        let poses = self.tree.body_poses(&self.actuation.joints(&self.actuation.open()));
        self.spheres
            .iter()
            .map(|s| (poses[s.body] * s.center - self.tool_point).norm() + s.radius)
            .fold(0.0, f64::max)
    }

    /// Contact candidate points and outward normals in the hand frame for the given body poses.
    pub fn candidates_at(&self, body_poses: &[Isometry3<f64>]) -> Vec<(Point3<f64>, Unit<Vector3<f64>>)> {
        self.candidates
            .iter()
            .map(|c| (body_poses[c.body] * c.point, body_poses[c.body].rotation * c.normal))
            .collect()
    }
}

/// A few lines for people: what the hand is, how it is driven, how far it opens, which frame it uses.
impl fmt::Display for Hand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let actuators = self.actuation.actuator_count();
        writeln!(f, "{} ({}), revision {}", self.display_name, self.id, self.revision)?;
        writeln!(
            f,
            "{} fingers, {} joints, {actuators} actuators, {} adaptive joints",
            self.fingers.len(),
            self.tree.joints.len(),
            self.actuation.coordinates.len() - actuators,
        )?;
        writeln!(f, "{} pads, {} contact candidates", self.pads.len(), self.candidates.len())?;
        writeln!(
            f,
            "{} collision shapes covered by {} spheres, {} pairs for self-collision",
            self.collision.len(),
            self.spheres.len(),
            self.self_pairs.len(),
        )?;
        match self.opening {
            Some(o) => writeln!(f, "opens from {:.1} to {:.1} mm", o.min_m * 1e3, o.max_m * 1e3)?,
            None => writeln!(f, "opening unknown: no opposed pads with room between them")?,
        }
        let (a, t) = (self.approach, self.tool_point);
        writeln!(
            f,
            "hand frame {:?}: approach ({:.3}, {:.3}, {:.3}), tool point ({:.4}, {:.4}, {:.4}) m",
            self.tree.links.first().map_or("", |l| l.name.as_str()),
            a.x,
            a.y,
            a.z,
            t.x,
            t.y,
            t.z
        )
    }
}

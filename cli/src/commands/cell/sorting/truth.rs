//! The truth about a simulated sorting cell: which object is where, and whether arms have met.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use graspd_adapters_core::async_trait;
use graspd_adapters_mock::{SharedWorld, WorldEnded};
use graspd_adapters_ur::kinematics::Joints;
use graspd_assign::Capsule;
use graspd_cell::sort::Recognizer;
use graspd_cell::sort::config::{Rule, SortConfig};
use graspd_cell::sort::report::{Collision, SortWitness, Truth};
use graspd_sim::world::{HandId, ObjectId, World};
use nalgebra::{Isometry3, Point3, Vector2};

use super::shape::UrShape;

/// Simulated seconds between two looks at the arms.
const LOOK_S: f64 = 0.02;
/// Simulated seconds for dropped things to fall before they are counted.
const REST_S: f64 = 0.8;
/// Widths are seen by a camera: an object this near to the limit of a rule may go either way, metres.
const WIDTH_ERROR_M: f64 = 0.015;

/// An arm that is watched.
pub(super) struct Watched {
    pub(super) name: String,
    pub(super) hand: HandId,
    pub(super) shape: UrShape,
}

/// Somebody's bodies at a moment: of the arm, and of its hand.
struct Bodies {
    /// What they are: the arm's, or a link of the hand.
    parts: Vec<(bool, usize, Capsule)>,
    middle: Point3<f64>,
    radius_m: f64,
}

/// Tells by physics and geometry what happened.
#[derive(Debug)]
pub(super) struct SortingTruth {
    shared: SharedWorld,
    began_s: f64,
    rules: Vec<Rule>,
    /// True width and class of each object.
    objects: BTreeMap<ObjectId, (f64, String)>,
    collisions: Arc<Mutex<Vec<Collision>>>,
}

impl SortingTruth {
    /// Watches from now on.
    pub(super) async fn new(
        shared: &SharedWorld,
        config: &SortConfig,
        arms: Vec<Watched>,
    ) -> Result<Self, WorldEnded> {
        let objects = shared
            .with(|world| world.ids().into_iter().filter_map(|id| Some((id, facts(world, id)?))).collect());
        let collisions = Arc::new(Mutex::new(Vec::new()));
        let seen = collisions.clone();
        let mut watch = Watch { last: vec![None; arms.len()], touching: Vec::new(), arms };
        let objects = objects.await?;
        shared
            .watch(LOOK_S, move |world| {
                let met = watch.look(world);
                if !met.is_empty() {
                    seen.lock().unwrap_or_else(PoisonError::into_inner).extend(met);
                }
            })
            .await?;
        Ok(Self {
            shared: shared.clone(),
            began_s: shared.time_s(),
            rules: config.rules.clone(),
            objects,
            collisions,
        })
    }

    /// True when some rule that names the bin may be that of the object.
    fn belongs(&self, id: ObjectId, bin: &str) -> bool {
        let Some((width, class)) = self.objects.get(&id) else { return false };
        let of = |width: f64| self.rules.iter().find(|rule| rule.fits(width, Some(class)));
        let widths = [-1.0, 0.0, 1.0].map(|s| width + s * WIDTH_ERROR_M);
        widths.into_iter().filter_map(of).any(|rule| rule.bins.iter().any(|b| b == bin))
    }
}

/// Width as seen from above, and class, of an object as it lies.
fn facts(world: &World, id: ObjectId) -> Option<(f64, String)> {
    let (object, pose) = (world.object(id)?, world.pose(id)?);
    let points: Vec<Vector2<f64>> = object.parts.iter().flatten().map(|p| (pose * p).coords.xy()).collect();
    let extent = |angle: f64| {
        let axis = Vector2::new(angle.cos(), angle.sin());
        let along = points.iter().map(|p| axis.dot(p));
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    };
    let width =
        (0..60).map(|i| extent(f64::from(i) * std::f64::consts::PI / 60.0)).fold(f64::INFINITY, f64::min);
    Some((width, class_of(&object.name)))
}

/// The family of an object, by its name: `mug-3` is a mug.
fn class_of(name: &str) -> String {
    name.trim_end_matches(|c: char| c.is_ascii_digit() || "-_ #".contains(c)).to_owned()
}

#[async_trait]
impl SortWitness for SortingTruth {
    async fn truth(&self) -> Option<Truth> {
        let time_s = self.shared.time_s() - self.began_s;
        // A world that has ended has nothing to tell; the devices report it.
        self.shared.wait(REST_S).await.ok()?;
        let census = self.shared.census().await.ok()?;
        let mut truth = Truth { time_s, ..Truth::default() };
        for object in &census.delivered {
            truth.delivered.entry(object.bin.clone()).or_default().push(object.name.clone());
            if !self.belongs(object.id, &object.bin) {
                truth.misplaced.push(object.name.clone());
            }
        }
        let names =
            |objects: &[graspd_adapters_mock::ObjectView]| objects.iter().map(|o| o.name.clone()).collect();
        truth.in_tray = names(&census.tray);
        truth.lost = names(&census.elsewhere);
        truth.in_hand = census.held.iter().map(|(_, o)| o.name.clone()).collect();
        truth.collisions.clone_from(&self.collisions.lock().unwrap_or_else(PoisonError::into_inner));
        Some(truth)
    }
}

/// Tells classes as a detector would that never errs.
#[derive(Debug)]
pub(super) struct NameRecognizer(pub(super) SharedWorld);

#[async_trait]
impl Recognizer for NameRecognizer {
    async fn classes(&self) -> Vec<(Point3<f64>, String)> {
        let objects = self.0.objects().await.unwrap_or_default();
        let of = |o: graspd_adapters_mock::ObjectView| {
            (Point3::from(o.world_from_object.translation.vector), class_of(&o.name))
        };
        objects.into_iter().map(of).collect()
    }
}

/// Looks at arms and hands again and again.
struct Watch {
    arms: Vec<Watched>,
    last: Vec<Option<Joints>>,
    /// Pairs that touch now: one collision until they part.
    touching: Vec<(usize, usize)>,
}

impl Watch {
    fn look(&mut self, world: &World) -> Vec<Collision> {
        let bodies: Vec<Option<Bodies>> = (0..self.arms.len()).map(|i| self.bodies(world, i)).collect();
        let mut met = Vec::new();
        for a in 0..bodies.len() {
            for b in 0..a {
                let (Some(first), Some(second)) = (&bodies[b], &bodies[a]) else { continue };
                let worst = deepest(first, second);
                let known = self.touching.iter().position(|pair| *pair == (b, a));
                match (worst, known) {
                    (Some((depth_m, parts)), None) => {
                        self.touching.push((b, a));
                        met.push(Collision {
                            between: [self.arms[b].name.clone(), self.arms[a].name.clone()],
                            parts: [self.part(world, b, parts.0), self.part(world, a, parts.1)],
                            time_s: world.time_s(),
                            depth_m,
                        });
                    }
                    (None, Some(at)) => {
                        self.touching.swap_remove(at);
                    }
                    _ => {}
                }
            }
        }
        met
    }

    fn part(&self, world: &World, arm: usize, (is_hand, index): (bool, usize)) -> String {
        const ARM: [&str; 8] =
            ["base", "shoulder", "upper arm", "elbow", "lower arm", "wrist 1", "wrist 2", "wrist 3"];
        if !is_hand {
            return ARM.get(index).copied().unwrap_or("arm").to_owned();
        }
        let link = world.hand(self.arms[arm].hand).and_then(|h| Some(h.tree.links.get(index)?.name.clone()));
        link.map_or_else(|| "hand".to_owned(), |name| format!("hand: {name}"))
    }

    /// The arm by its kinematics, in the posture next to the last one; the hand by the spheres that cover it.
    fn bodies(&mut self, world: &World, i: usize) -> Option<Bodies> {
        let arm = &self.arms[i];
        let (hand, state) = (world.hand(arm.hand)?, world.hand_state(arm.hand)?);
        let flange: Isometry3<f64> = state.world_from_hand;
        let joints = match &self.last[i] {
            None => arm.shape.usual(&flange),
            Some(near) => arm.shape.next(&flange, near).or(Some(*near)),
        };
        self.last[i] = joints;
        let mut parts = Vec::new();
        if let Some(joints) = joints {
            let bodies = arm.shape.posture(&joints).bodies;
            parts.extend(bodies.into_iter().enumerate().map(|(k, c)| (false, k, c)));
        }
        let poses = hand.tree.body_poses(&state.joints);
        parts.extend(hand.spheres.iter().map(|s| {
            let at = flange * poses[s.body] * s.center;
            (true, s.link, Capsule { a: at, b: at, radius_m: s.radius })
        }));
        let sum: nalgebra::Vector3<f64> = parts.iter().map(|(.., c)| c.a.coords).sum();
        let middle = Point3::from(sum / parts.len().max(1) as f64);
        let radius_m =
            parts.iter().map(|(.., c)| (c.a - middle).norm().max((c.b - middle).norm()) + c.radius_m);
        Some(Bodies { radius_m: radius_m.fold(0.0, f64::max), middle, parts })
    }
}

/// A part of an arm: of its hand or not, and which.
type Part = (bool, usize);

/// The parts that overlap most, if any do.
fn deepest(a: &Bodies, b: &Bodies) -> Option<(f64, (Part, Part))> {
    if (a.middle - b.middle).norm() > a.radius_m + b.radius_m {
        return None;
    }
    let mut worst: Option<(f64, (Part, Part))> = None;
    for (hand, index, capsule) in &a.parts {
        for (other_hand, other_index, other) in &b.parts {
            // Most spheres are far apart: tell by their middles first.
            let reach = capsule.radius_m + other.radius_m;
            let along = (capsule.b - capsule.a).norm() + (other.b - other.a).norm();
            if (capsule.a - other.a).norm() > reach + along {
                continue;
            }
            let depth = -capsule.distance(other);
            if depth > 0.0 && worst.as_ref().is_none_or(|w| depth > w.0) {
                worst = Some((depth, ((*hand, *index), (*other_hand, *other_index))));
            }
        }
    }
    worst
}

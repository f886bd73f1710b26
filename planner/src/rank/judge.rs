//! Judging one optimized candidate: a grasp with its figures, or the reason why not.

use std::collections::BTreeMap;

use nalgebra::{Point3, Translation3, Unit, Vector3};

use super::collision::{self, SCENE_TOLERANCE_VOXELS, SELF_TOLERANCE_M, TABLE_TOLERANCE_M};
use super::force_closure::{self, Directions, Push};
use super::touch::{self, ALIGNED, CONTACT_VOXELS, Touch};
use super::{closing, opposition, score};
use crate::budget::Budget;
use crate::configuration::Configuration;
use crate::grasp::{Grasp, ObjectiveTerms, Postures, RejectReason};
use crate::hand_model::HandModel;
use crate::objective::{Objective, Scratch};
use crate::optimize::Candidate;
use crate::options::{PlanOptions, Target};
use crate::orientation::Allowed;
use crate::refine::CenteredCentroid;
use crate::scene::Scene;

/// Smallest force-closure margin.
const LEAST_MARGIN: f64 = 0.005;
/// Openings that are tried for the approach, from fully open (share of the way from contact to open).
const OPENINGS: [f64; 4] = [1.0, 0.6, 0.35, 0.2];
/// A coordinate within this share of its range from the open end is as open as it gets.
const OPEN_END: f64 = 0.08;

/// Why a candidate was rejected, and by how much.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rejection {
    pub(crate) reason: RejectReason,
    /// How far it is from passing, metres for collisions, else 0.
    pub(crate) by_m: f64,
}

impl Rejection {
    pub(crate) fn new(reason: RejectReason, by_m: f64) -> Self {
        Self { reason, by_m }
    }
}

/// What all candidates of a ranking share.
#[derive(Debug)]
pub(crate) struct Judge<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) objective: &'a Objective<'a>,
    pub(crate) allowed: &'a Allowed,
    pub(crate) options: &'a PlanOptions,
    pub(crate) directions: &'a Directions,
}

impl Judge<'_> {
    /// Closes the fingers, checks everything, and makes a grasp of the candidate. The budget is asked only whether anybody
    /// waits for it: a judgement that was begun before a deadline is worth its end.
    pub(crate) fn judge(
        &self,
        candidate: &Candidate,
        scratch: &mut Scratch,
        budget: &dyn Budget,
    ) -> Result<Grasp, Rejection> {
        use RejectReason as R;
        let model = self.objective.model;
        if !candidate.has_started() {
            return Err(Rejection::new(R::Unfinished, 0.0));
        }
        if !candidate.best.is_finite() || !candidate.terms.total.is_finite() {
            return Err(Rejection::new(R::Diverged, 0.0));
        }
        let mut at = candidate.best.clone();
        scratch.contacts.share.copy_from_slice(&candidate.shares);
        closing::close(self.objective, &mut at, scratch, budget);
        if budget.is_cancelled() {
            return Err(Rejection::new(R::Unfinished, 0.0));
        }
        // The objective of what is returned: closing has moved the fingers since the last iteration.
        let mut unused = vec![0.0; 6 + model.coordinate_count];
        let terms = self.objective.evaluate(&at, &candidate.reaching, true, scratch, &mut unused);
        let mean = scratch.contacts.mean();
        let size = self.scene.workspace.grid.size_m;
        if mean.iter().any(|v| !(0.0..=size).contains(v)) {
            return Err(Rejection::new(R::OutOfWorkspace, 0.0));
        }
        if !self.allowed.holds(model, &candidate.reaching, &at) {
            return Err(Rejection::new(R::OrientationLimit, 0.0));
        }
        let touches = touch::of_one_object(self.touches(scratch));
        let center = touch::middle(&touches).unwrap_or(mean);
        let centroid = self.nearest_centroid(&center);
        let label = self.touched_label(&touches);
        if !self.is_target(&centroid, label) {
            return Err(Rejection::new(R::NotTarget, 0.0));
        }
        let touching = touch::touching_bodies(model, &touches);
        let depths = collision::depths(self.objective, &at, &touching, scratch);
        let tolerance = SCENE_TOLERANCE_VOXELS * self.scene.workspace.grid.voxel_m();
        if depths.scene > tolerance {
            let wide = depths.fingers_in_scene >= 2 && is_fully_open(model, &at);
            let reason = if wide { R::TooWide } else { R::CollisionScene };
            return Err(Rejection::new(reason, depths.scene - tolerance));
        }
        if depths.table > TABLE_TOLERANCE_M {
            return Err(Rejection::new(R::CollisionTable, depths.table - TABLE_TOLERANCE_M));
        }
        if depths.itself > SELF_TOLERANCE_M {
            return Err(Rejection::new(R::CollisionSelf, depths.itself - SELF_TOLERANCE_M));
        }
        if depths.keep_out > 0.0 {
            return Err(Rejection::new(R::KeepOut, depths.keep_out));
        }
        if touch::fingers_touching(model, &touches) < 2 {
            return Err(Rejection::new(R::NoContact, 0.0));
        }
        let back = self.options.pregrasp_offset_m.max(0.0);
        let (open, room_on_the_way) = self.clear_opening(&at, back, &touching, scratch, budget)?;
        // A hand all of whose parts touch has no room that could be measured: finite all the same.
        let room = depths.room.min(room_on_the_way).min(size);
        if budget.is_cancelled() {
            return Err(Rejection::new(R::Unfinished, 0.0));
        }
        let arms: Vec<Push> =
            touches.iter().map(|t| Push { arm: t.point - center, inward: t.inward.into_inner() }).collect();
        let length = arms.iter().map(|p| p.arm.norm()).fold(0.01, f64::max);
        let sides = touches.iter().map(|t| (model.hand.pads[t.pad].finger, t.point, t.pad_normal));
        if !opposition::face_each_other(&opposition::sides(model.hand.fingers.len(), sides)) {
            return Err(Rejection::new(R::NoForceClosure, 0.0));
        }
        if !touch::opposed(model, &touches, self.options.friction) {
            return Err(Rejection::new(R::NoForceClosure, 0.0));
        }
        let epsilon = force_closure::margin(&arms, self.options.friction, length, self.directions);
        if epsilon < LEAST_MARGIN {
            return Err(Rejection::new(R::NoForceClosure, 0.0));
        }
        let certainty = touches.iter().map(|t| t.certainty).sum::<f64>() / touches.len() as f64;
        let margin = epsilon * touch::squareness(&touches);
        let parts = score::parts(self.contact_objective(&terms), margin, room, certainty);
        let score = model.hand.confidence.probability(parts.mean());
        if score < self.options.min_score {
            return Err(Rejection::new(R::LowScore, 0.0));
        }
        let figures = Figures { open, epsilon, room, terms, centroid, label };
        Ok(self.grasp(&at, &touches, &figures, parts, score, back))
    }

    /// The objective without what closing does on purpose: pads press into the surface (collision has its own
    /// check) and adaptive joints leave their preference to follow the object.
    fn contact_objective(&self, terms: &ObjectiveTerms) -> f64 {
        let w = &self.objective.weights;
        terms.total - w.penetration * terms.penetration - w.coupling * terms.coupling
    }

    /// Candidates that touch: near the surface and facing it.
    fn touches(&self, scratch: &Scratch) -> Vec<Touch> {
        let contacts = &scratch.contacts;
        let hand = self.objective.model.hand;
        let reach = CONTACT_VOXELS * self.scene.workspace.grid.voxel_m();
        (0..contacts.len())
            .filter_map(|i| {
                let (gap, slope) = self.objective.obstacles.scene(&contacts.point[i]);
                if gap > reach {
                    return None;
                }
                let candidate = &hand.candidates[i];
                let look = &contacts.look[i];
                let inward = Unit::try_new(look.inward(), 1e-3).or_else(|| Unit::try_new(-slope, 1e-3))?;
                if contacts.normal[i].dot(&inward) < ALIGNED {
                    return None;
                }
                // The surface that is really there must face the pad too: near edges the field's direction can
                // belong to another side.
                let away = slope.try_normalize(1e-3).unwrap_or_else(|| -inward.into_inner());
                if -contacts.normal[i].dot(&away) < ALIGNED {
                    return None;
                }
                // Where the pad will press: the surface point nearest to the candidate.
                let certainty = look.certainty();
                let point = contacts.point[i] - away * gap;
                let object = self.objective.obstacles.object_behind(&point, &inward);
                Some(Touch {
                    point,
                    object,
                    inward,
                    pad: candidate.pad,
                    body: candidate.body,
                    certainty,
                    pad_normal: contacts.normal[i],
                })
            })
            .collect()
    }

    /// The centred centroid nearest to the middle of the contacts, of all that the scene has, volume frame.
    fn nearest_centroid(&self, center: &Vector3<f64>) -> Point3<f64> {
        let apart = |c: &CenteredCentroid| (c.position.coords - center).norm_squared();
        let all = &self.scene.features.centroids;
        let nearest = all.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
        nearest.map_or(Point3::from(*center), |c| c.position)
    }

    /// The label that most touched points have behind them, where the frames had labels.
    fn touched_label(&self, touches: &[Touch]) -> Option<u8> {
        let labels = self.scene.volume.voxel_labels()?;
        let mut counts = BTreeMap::new();
        for t in touches {
            let behind = self
                .objective
                .obstacles
                .behind(&t.point, &t.inward, |i| (labels[i] > 0).then_some(labels[i]));
            if let Some(label) = behind {
                *counts.entry(label).or_insert(0usize) += 1;
            }
        }
        counts.into_iter().max_by(|a, b| a.1.cmp(&b.1).then(b.0.cmp(&a.0))).map(|(label, _)| label)
    }

    fn is_target(&self, centroid: &Point3<f64>, label: Option<u8>) -> bool {
        match &self.options.target {
            None => true,
            Some(Target::Label(wanted)) => label == Some(*wanted),
            Some(Target::Point { point, radius_m }) => {
                let world = self.scene.workspace.world_from_volume * centroid;
                (world - point).norm() <= *radius_m
            }
        }
    }

    /// Coordinates of the widest opening with which the straight approach is free, and the room on the way.
    fn clear_opening(
        &self,
        at: &Configuration,
        back: f64,
        touching: &[bool],
        scratch: &mut Scratch,
        budget: &dyn Budget,
    ) -> Result<(Vec<f64>, f64), Rejection> {
        let mut least = f64::INFINITY;
        for share in OPENINGS {
            if budget.is_cancelled() {
                return Err(Rejection::new(RejectReason::Unfinished, 0.0));
            }
            let open = closing::opened(self.objective.model, &at.coordinates, share);
            let met = collision::approach(self.objective, at, &open, back, touching, scratch);
            if met.depth <= 0.0 {
                return Ok((open, met.room));
            }
            least = least.min(met.depth);
        }
        Err(Rejection::new(RejectReason::ApproachBlocked, least))
    }

    fn grasp(
        &self,
        at: &Configuration,
        touches: &[Touch],
        figures: &Figures,
        parts: crate::grasp::ScoreParts,
        score: f64,
        back: f64,
    ) -> Grasp {
        let model = self.objective.model;
        let world_from_volume = self.scene.workspace.world_from_volume;
        let world_from_hand = world_from_volume * at.volume_from_hand();
        let retreat = world_from_hand.rotation * model.approach * -back;
        let world_from_pregrasp = Translation3::from(retreat) * world_from_hand;
        let squeezed = closing::squeezed(model, &at.coordinates);
        let actuation = &model.hand.actuation;
        let joints = |u: &[f64]| actuation.joints(u);
        let actuators = |u: &[f64]| -> Vec<f64> {
            u.iter()
                .zip(&actuation.coordinates)
                .filter(|(_, c)| c.kind == graspd_hands::CoordinateKind::Actuator)
                .map(|(&u, _)| u)
                .collect()
        };
        Grasp {
            world_from_hand,
            camera_from_hand: self.scene.world_from_camera.inverse() * world_from_hand,
            world_from_pregrasp,
            joints: Postures {
                open: joints(&figures.open),
                contact: joints(&at.coordinates),
                squeezed: joints(&squeezed),
            },
            actuators: Postures {
                open: actuators(&figures.open),
                contact: actuators(&at.coordinates),
                squeezed: actuators(&squeezed),
            },
            contacts: touch::contacts_by_pad(model, touches, &world_from_volume),
            jaw_width_m: touch::jaw_width(model, touches),
            score,
            parts,
            objective: figures.terms,
            epsilon: figures.epsilon,
            clearance_m: figures.room,
            centroid: world_from_volume * figures.centroid,
            label: figures.label,
        }
    }
}

/// What was measured of an accepted candidate.
struct Figures {
    open: Vec<f64>,
    epsilon: f64,
    room: f64,
    terms: ObjectiveTerms,
    centroid: Point3<f64>,
    label: Option<u8>,
}

/// True when every closing coordinate is at its open end.
fn is_fully_open(model: &HandModel<'_>, at: &Configuration) -> bool {
    at.coordinates.iter().zip(&model.hand.actuation.coordinates).all(|(&u, c)| {
        let range = (c.closed - c.open).abs();
        range == 0.0 || (u - c.open).abs() <= OPEN_END * range
    })
}

//! The objectives `O_*` of a hand configuration, with analytic gradients.
//!
//! Each evaluation costs the same whatever the scene: contact candidates and collision spheres look up
//! fields, their gradients are gathered per body and carried up the kinematic tree once.

mod closure;
mod contact;
mod penetration;
mod posture;
#[cfg(test)]
mod tests;
mod weights;

pub use weights::Weights;

pub(crate) use contact::Look;
pub(crate) use penetration::Obstacles;

use nalgebra::Vector3;

use crate::configuration::{Configuration, Kinematics};
use crate::grasp::ObjectiveTerms;
use crate::hand_model::HandModel;
use crate::refine::{CenteredCentroid, FieldCells};

/// The contact candidates of one configuration: where they are, what the fields say there, and what
/// the objectives want of them.
#[derive(Debug, Clone)]
pub(crate) struct Contacts {
    pub(crate) point: Vec<Vector3<f64>>,
    pub(crate) normal: Vec<Vector3<f64>>,
    pub(crate) look: Vec<Look>,
    pub(crate) point_gradient: Vec<Vector3<f64>>,
    pub(crate) normal_gradient: Vec<Vector3<f64>>,
    /// Share of the push of each candidate.
    pub(crate) push: Vec<f64>,
    /// What each candidate counts in means; sums to 1.
    pub(crate) share: Vec<f64>,
}

impl Contacts {
    pub(crate) fn new(count: usize) -> Self {
        Self {
            point: vec![Vector3::zeros(); count],
            normal: vec![Vector3::zeros(); count],
            look: vec![Look::default(); count],
            point_gradient: vec![Vector3::zeros(); count],
            normal_gradient: vec![Vector3::zeros(); count],
            push: vec![0.0; count],
            share: vec![1.0 / count.max(1) as f64; count],
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.point.len()
    }

    /// The mean contact `c̄`.
    pub(crate) fn mean(&self) -> Vector3<f64> {
        self.point.iter().zip(&self.share).map(|(p, share)| p * *share).sum()
    }
}

/// What a configuration is judged by: one hand in one scene.
#[derive(Debug, Clone)]
pub(crate) struct Objective<'a> {
    pub(crate) model: &'a HandModel<'a>,
    pub(crate) cells: &'a FieldCells,
    pub(crate) centroids: &'a [CenteredCentroid],
    pub(crate) obstacles: Obstacles<'a>,
    pub(crate) weights: Weights,
}

/// Memory of one evaluation, reused for all of them.
#[derive(Debug, Clone)]
pub(crate) struct Scratch {
    pub(crate) kinematics: Kinematics,
    pub(crate) contacts: Contacts,
    pub(crate) centers: Vec<Vector3<f64>>,
    joint_gradient: Vec<f64>,
}

impl Scratch {
    pub(crate) fn new(model: &HandModel<'_>) -> Self {
        Self {
            kinematics: Kinematics::new(model),
            contacts: Contacts::new(model.points.len()),
            centers: vec![Vector3::zeros(); model.spheres.len()],
            joint_gradient: vec![0.0; model.joint_count],
        }
    }
}

impl Objective<'_> {
    /// Forward kinematics and field look-ups of a configuration, without any gradient.
    pub(crate) fn look(&self, configuration: &Configuration, scratch: &mut Scratch) {
        scratch.kinematics.forward(self.model, configuration);
        let contacts = &mut scratch.contacts;
        for (i, p) in self.model.points.iter().enumerate() {
            contacts.point[i] = scratch.kinematics.point(p.body, &p.point);
            contacts.normal[i] = scratch.kinematics.direction(p.body, &p.normal);
            contacts.look[i] = Look::at(self.cells, &contacts.point[i]);
        }
    }

    /// Places the collision spheres of the configuration that was looked at last.
    pub(crate) fn place_spheres(&self, scratch: &mut Scratch) {
        for (center, s) in scratch.centers.iter_mut().zip(&self.model.spheres) {
            *center = scratch.kinematics.point(s.body, &s.center);
        }
    }

    /// All terms of a configuration and the gradient of their weighted sum in its tangent space (see
    /// [`Configuration`]). `reaching` is the candidate's own reaching direction. Does not allocate.
    pub(crate) fn evaluate(
        &self,
        configuration: &Configuration,
        reaching: &Vector3<f64>,
        with_penetration: bool,
        scratch: &mut Scratch,
        gradient: &mut [f64],
    ) -> ObjectiveTerms {
        let w = &self.weights;
        self.look(configuration, scratch);
        let contacts = &mut scratch.contacts;
        contacts.point_gradient.fill(Vector3::zeros());
        contacts.normal_gradient.fill(Vector3::zeros());
        scratch.joint_gradient.fill(0.0);
        scratch.kinematics.clear_loads();

        let (contact_distance, certainty, orientation, nearest) = contact::all(contacts, self.centroids, w);
        let center = nearest.map_or_else(|| contacts.mean(), |(_, i)| self.centroids[i].position.coords);
        let length = w.characteristic_length_m;
        let independence =
            closure::independence(contacts, &center, length, w.independence_floor, w.independence);
        let net_wrench = closure::net_wrench(contacts, &center, length, w.net_wrench);

        let kinematics = &mut scratch.kinematics;
        for (i, p) in self.model.points.iter().enumerate() {
            kinematics.load_point(p.body, &contacts.point[i], &contacts.point_gradient[i]);
            kinematics.load_direction(p.body, &contacts.normal[i], &contacts.normal_gradient[i]);
        }
        let axis = kinematics.direction(0, &self.model.approach);
        let (approach, slope) = posture::approach(&axis, reaching);
        kinematics.load_direction(0, &axis, &(slope * w.approach));

        let joints = &self.model.hand.tree.joints;
        let g = &mut scratch.joint_gradient;
        let joint_limits = posture::joint_limits(&scratch.kinematics.q, joints, w.joint_limits, g);
        let soft = &self.model.hand.actuation.couplings;
        let coupling = posture::couplings(&scratch.kinematics.q, soft, w.coupling, g);

        let penetration = if with_penetration { self.penetrate(scratch) } else { 0.0 };
        scratch.kinematics.pull_back(self.model, configuration, &scratch.joint_gradient, gradient);

        let centroid = nearest.map_or(0.0, |(d, _)| d);
        let total = w.contact_distance * contact_distance
            + w.certainty * certainty
            + w.orientation * orientation
            + w.centroid * centroid
            + w.independence * independence
            + w.net_wrench * net_wrench
            + w.approach * approach
            + w.joint_limits * joint_limits
            + w.coupling * coupling
            + w.penetration * penetration;
        ObjectiveTerms {
            contact_distance,
            certainty,
            orientation,
            centroid,
            independence,
            net_wrench,
            approach,
            joint_limits,
            coupling,
            penetration,
            total,
        }
    }

    /// Depth of all spheres in scene, table, boxes and each other (metres, summed); loads the gradients.
    fn penetrate(&self, scratch: &mut Scratch) -> f64 {
        let weight = self.weights.penetration;
        self.place_spheres(scratch);
        let mut sum = 0.0;
        for (i, s) in self.model.spheres.iter().enumerate() {
            let center = scratch.centers[i];
            let (depth, g) = self.obstacles.depth(&center, s.radius);
            if depth > 0.0 {
                sum += depth;
                scratch.kinematics.load_point(s.body, &center, &(g * weight));
            }
        }
        for &(a, b) in &self.model.hand.self_pairs {
            let (sa, sb) = (&self.model.spheres[a], &self.model.spheres[b]);
            let gap = scratch.centers[a] - scratch.centers[b];
            let touch = sa.radius + sb.radius;
            let squared = gap.norm_squared();
            if squared >= touch * touch || squared == 0.0 {
                continue;
            }
            let distance = squared.sqrt();
            sum += touch - distance;
            let g = gap * (-weight / distance);
            scratch.kinematics.load_point(sa.body, &scratch.centers[a].clone(), &g);
            scratch.kinematics.load_point(sb.body, &scratch.centers[b].clone(), &-g);
        }
        sum
    }
}

//! Initial hand configurations, exactly as Supplementary Note 4 describes them.

use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;

use crate::configuration::{Configuration, Kinematics};
use crate::hand_model::HandModel;
use crate::options::PlanOptions;
use crate::orientation::{INITIAL_CONE_RAD, align, cone_sample, reaching_direction};
use crate::refine::CenteredCentroid;

/// Where initial configurations come from: one hand, one scene, one request.
#[derive(Debug, Clone)]
pub(crate) struct Initializer<'a> {
    pub(crate) model: &'a HandModel<'a>,
    pub(crate) centroids: &'a [CenteredCentroid],
    pub(crate) options: &'a PlanOptions,
    pub(crate) world_from_volume: Isometry3<f64>,
    pub(crate) view: Unit<Vector3<f64>>,
}

impl Initializer<'_> {
    /// Draws one configuration and its reaching direction `v_hg` (volume frame).
    ///
    /// Joints lie in the first `γ_j` of their closing range; the approach axis within π/6 (or the allowed
    /// cone, if that is narrower) of the reaching direction, the roll about it is free; the mean contact
    /// candidate starts the hand's start offset (0.05 m) before a weighted random centred centroid.
    pub(crate) fn draw(&self, rng: &mut impl rand::Rng) -> (Configuration, Vector3<f64>) {
        let reaching = reaching_direction(&self.options.reaching, &self.world_from_volume, &self.view, rng);
        let cone = INITIAL_CONE_RAD.min(self.options.orientation.cone_rad.max(0.0));
        let axis = cone_sample(&reaching, cone, rng);
        let roll = rng.random::<f64>() * std::f64::consts::TAU;
        let rotation = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), roll)
            * UnitQuaternion::from_rotation_matrix(&align(&self.model.approach, &axis));
        let gamma = self.options.opening_fraction;
        let coordinates = self
            .model
            .hand
            .actuation
            .coordinates
            .iter()
            .map(|c| {
                let towards = if c.closed != c.open {
                    c.closed
                } else if c.upper - c.open >= c.open - c.lower {
                    c.upper
                } else {
                    c.lower
                };
                (c.open + gamma * rng.random::<f64>() * (towards - c.open)).clamp(c.lower, c.upper)
            })
            .collect();
        let mut configuration = Configuration { translation: Vector3::zeros(), rotation, coordinates };
        let mut kinematics = Kinematics::new(self.model);
        kinematics.forward(self.model, &configuration);
        let points = &self.model.points;
        let mean = points.iter().map(|p| kinematics.point(p.body, &p.point)).sum::<Vector3<f64>>()
            / points.len().max(1) as f64;
        let target = self.pick(rng);
        configuration.translation = target - mean - axis * self.model.hand.start_offset_m;
        (configuration, reaching)
    }

    /// A centred centroid, drawn by weight.
    fn pick(&self, rng: &mut impl rand::Rng) -> Vector3<f64> {
        let total: f64 = self.centroids.iter().map(|c| c.weight).sum();
        let mut left = rng.random::<f64>() * total;
        for c in self.centroids {
            left -= c.weight;
            if left <= 0.0 {
                return c.position.coords;
            }
        }
        self.centroids.last().map_or_else(Vector3::zeros, |c| c.position.coords)
    }
}

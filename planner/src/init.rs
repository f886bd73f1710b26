//! Initial hand configurations: half of them exactly as Supplementary Note 4 describes them, half shaped for something
//! smaller.

use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;

use crate::balance;
use crate::configuration::{Configuration, Kinematics};
use crate::hand_model::HandModel;
use crate::options::PlanOptions;
use crate::orientation::{INITIAL_CONE_RAD, align, cone_sample, reaching_direction};
use crate::refine::CenteredCentroid;

/// Hands that start shaped for a small object start closed by up to this share.
const MOST_CLOSED: f64 = 0.8;

/// How evenly pads count, against how well their pushes balance, lies between these (see [`balance`]).
const LEAST_EVEN: f64 = 0.5;
const MOST_EVEN: f64 = 10.0;
/// Share of the hands with three fingers or more that start as a pinch of two.
const PINCHING: f64 = 0.4;
/// Two fingers can pinch when the mean normals of their pads differ by more than the angle with minus this cosine (120°).
const FACING: f64 = 0.5;

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
    /// Joints lie in the first `γ_j` of their closing range, for half of the hands of what is left of it after they
    /// have closed by a random share; the approach axis within π/6 (or the allowed
    /// cone, if that is narrower) of the reaching direction, the roll about it is free; the mean contact
    /// candidate starts the hand's start offset (0.05 m) before a weighted random centred centroid. Also returns
    /// what each contact candidate counts in that mean and in the objectives (see [`balance`]).
    pub(crate) fn draw(&self, rng: &mut impl rand::Rng) -> (Configuration, Vector3<f64>, Vec<f64>) {
        let reaching = reaching_direction(&self.options.reaching, &self.world_from_volume, &self.view, rng);
        let cone = INITIAL_CONE_RAD.min(self.options.orientation.cone_rad.max(0.0));
        let axis = cone_sample(&reaching, cone, rng);
        let roll = rng.random::<f64>() * std::f64::consts::TAU;
        let rotation = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), roll)
            * UnitQuaternion::from_rotation_matrix(&align(&self.model.approach, &axis));
        let gamma = self.options.opening_fraction;
        // Half of the hands start shaped for something smaller than their widest opening: fingers that turn about
        // knuckles meet deeper than they open, and from wide open the way to a small object leads through the table.
        let shaped = if rng.random::<bool>() { rng.random::<f64>() * MOST_CLOSED } else { 0.0 };
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
                let shaped = if c.closed != c.open { shaped } else { 0.0 };
                let share = shaped + (1.0 - shaped) * gamma * rng.random::<f64>();
                (c.open + share * (towards - c.open)).clamp(c.lower, c.upper)
            })
            .collect();
        let mut configuration = Configuration { translation: Vector3::zeros(), rotation, coordinates };
        let mut kinematics = Kinematics::new(self.model);
        kinematics.forward(self.model, &configuration);
        let points = &self.model.points;
        let normals: Vec<Vector3<f64>> =
            points.iter().map(|p| kinematics.direction(p.body, &p.normal)).collect();
        let used = self.used(&normals, rng);
        // From nearly balanced to nearly even: which of the two brings a hand to an object depends on both.
        let evenness = LEAST_EVEN * (MOST_EVEN / LEAST_EVEN).powf(rng.random::<f64>());
        let shares = balance::shares(&normals, &used, self.model.hand.pads.len(), evenness);
        let mean: Vector3<f64> =
            points.iter().zip(&shares).map(|(p, w)| kinematics.point(p.body, &p.point) * *w).sum();
        let target = self.pick(rng);
        configuration.translation = target - mean - axis * self.model.hand.start_offset_m;
        (configuration, reaching, shares)
    }

    /// Which contact candidates a configuration grasps with: those of all fingers or, for some of the hands, those of
    /// two fingers that face each other. What is small has no room for more, and a hand whose fingers stand in pairs
    /// takes it between the two of one pair, not in its middle.
    fn used(&self, normals: &[Vector3<f64>], rng: &mut impl rand::Rng) -> Vec<bool> {
        let hand = self.model.hand;
        let finger = |i: usize| hand.pads[hand.candidates[i].pad].finger;
        let all = vec![true; normals.len()];
        if hand.fingers.len() < 3 || rng.random::<f64>() >= PINCHING {
            return all;
        }
        let mut push = vec![Vector3::zeros(); hand.fingers.len()];
        for (i, n) in normals.iter().enumerate() {
            push[finger(i)] += n;
        }
        let facing: Vec<(usize, usize)> = (0..push.len())
            .flat_map(|a| (0..a).map(move |b| (b, a)))
            .filter(|&(a, b)| push[a].dot(&push[b]) < -FACING * push[a].norm() * push[b].norm())
            .collect();
        if facing.is_empty() {
            return all;
        }
        let (a, b) = facing[rng.random_range(0..facing.len())];
        (0..normals.len()).map(|i| finger(i) == a || finger(i) == b).collect()
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

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use rand::SeedableRng;
    use rand_xoshiro::Xoshiro256PlusPlus;

    use super::*;
    use crate::random_hand::random_hand;

    #[test]
    fn initial_configurations_are_as_note_4_says() {
        let hand = random_hand(3);
        let model = HandModel::new(&hand);
        let centroids = [0.1, 0.3].map(|x| CenteredCentroid {
            position: Point3::new(x, 0.2, 0.15),
            weight: 0.5,
            voxel_count: 1,
            label: None,
        });
        let options = PlanOptions::default();
        let initializer = Initializer {
            model: &model,
            centroids: &centroids,
            options: &options,
            world_from_volume: Isometry3::identity(),
            view: Unit::new_unchecked(-Vector3::z()),
        };
        let rng = &mut Xoshiro256PlusPlus::seed_from_u64(9);
        let mut kinematics = Kinematics::new(&model);
        let (mut chosen, mut wide) = ([0usize; 2], 0);
        for _ in 0..200 {
            let (configuration, reaching, weights) = initializer.draw(rng);
            let axis = configuration.rotation * model.approach;
            assert!(axis.angle(&reaching) < INITIAL_CONE_RAD + 1e-9);
            let shares: Vec<f64> = configuration
                .coordinates
                .iter()
                .zip(&hand.actuation.coordinates)
                .map(|(u, c)| (u - c.open) / (c.closed - c.open))
                .collect();
            assert!(shares.iter().all(|s| (0.0..=1.0).contains(s)), "{shares:?}");
            wide += usize::from(shares.iter().all(|s| *s <= options.opening_fraction));
            kinematics.forward(&model, &configuration);
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            let points = model.points.iter().zip(&weights);
            let mean: Vector3<f64> = points.map(|(p, w)| kinematics.point(p.body, &p.point) * *w).sum();
            let target = mean + axis * hand.start_offset_m;
            let which = centroids.iter().position(|c| (c.position.coords - target).norm() < 1e-9);
            chosen[which.expect("the back-off starts at a centroid")] += 1;
        }
        // Half of them are as wide open as Note 4 has them, and a few of the others by chance.
        assert!((80..160).contains(&wide), "{wide} of 200 start wide open");
        assert!(chosen.iter().all(|&n| n > 60), "both centroids are drawn by their weight: {chosen:?}");
    }
}

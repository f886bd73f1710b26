//! A second way to close: the hand is placed anew with its fingers part of the way closed.
//!
//! The optimizer flattens a hand over a small object, since open fingers lie lower than curled ones, and fingers
//! that turn about their knuckles then meet somewhere else than where they were. Here the hand takes a few shapes
//! between open and closed; in each, the place where its pads balance each other goes to the object's centroid,
//! the hand is drawn back along its approach until it is free, and closed from there.

use nalgebra::Vector3;

use super::closing::{Closer, DRAW_M, SHIFT_M, STEP_M, TABLE_ROOM_M, feel, is_object};
use super::opposition;
use super::touch::{ALIGNED, CONTACT_VOXELS};
use crate::balance;
use crate::budget::Budget;
use crate::configuration::Configuration;
use crate::objective::{Objective, Scratch};

/// Shapes that are tried: shares of the way from where the optimizer left the fingers to closed.
const SHAPES: [f64; 5] = [0.2, 0.4, 0.55, 0.7, 0.85];
/// How evenly pads count where they are to balance each other (see [`balance`]).
const EVENNESS: f64 = 0.2;
/// The hand is drawn back by at least this much at a time, metres ...
const LEAST_STEP_M: f64 = 0.001;
/// ... and this far at most.
const FARTHEST_M: f64 = 0.06;

/// Fingers that close together go at most this far in a round, metres.
const PACE_M: f64 = 0.003;
/// The hand follows its fingers down while its spheres are no deeper in the scene than this, voxels.
const FREE_VOXELS: f64 = 0.5;
/// Rounds of closing together.
const ROUNDS: usize = 120;
/// Where the hand gives way to the table it gives so much more, metres.
const SLACK_M: f64 = 0.0005;

/// How well fingers hold: 0 where no two of those that touch face each other, else the sum over the touching fingers
/// of 1 at contact down to 0 at the distance that just counts as one.
pub(super) fn hold(objective: &Objective<'_>, at: &Configuration, scratch: &mut Scratch) -> f64 {
    let model = objective.model;
    let hand = model.hand;
    scratch.kinematics.forward(model, at);
    let kinematics = &scratch.kinematics;
    let reach = CONTACT_VOXELS * objective.obstacles.grid.voxel_m();
    let mut nearness = vec![0.0_f64; hand.fingers.len()];
    let touches = model.points.iter().zip(&hand.candidates).filter_map(|(p, c)| {
        let point = kinematics.point(p.body, &p.point);
        let (gap, away) = objective.obstacles.scene(&point);
        let normal = kinematics.direction(p.body, &p.normal);
        let faces = -normal.dot(&away) >= ALIGNED * away.norm();
        if gap > reach || !faces || !is_object(objective, &point, gap, &away) {
            return None;
        }
        let finger = hand.pads[c.pad].finger;
        nearness[finger] = nearness[finger].max(1.0 - gap.max(0.0) / reach);
        Some((finger, point, normal))
    });
    let sides = opposition::sides(hand.fingers.len(), touches);
    if opposition::face_each_other(&sides) { nearness.iter().sum() } else { 0.0 }
}

/// Tries the shapes and leaves the best in `configuration`, if one holds.
pub(super) fn regrip(
    objective: &Objective<'_>,
    closers: &[Closer],
    start: &Configuration,
    configuration: &mut Configuration,
    scratch: &mut Scratch,
    budget: &dyn Budget,
) {
    let model = objective.model;
    let mean = {
        scratch.kinematics.forward(model, start);
        let points = model.points.iter().zip(&scratch.contacts.share);
        points.map(|(p, w)| scratch.kinematics.point(p.body, &p.point) * *w).sum::<Vector3<f64>>()
    };
    let apart = |p: &Vector3<f64>| (p - mean).norm_squared();
    let centroids = objective.centroids.iter().map(|c| c.position.coords);
    let Some(target) = centroids.min_by(|a, b| apart(a).total_cmp(&apart(b))) else { return };
    let used: Vec<bool> = scratch.contacts.share.iter().map(|w| *w > 0.0).collect();
    let back = -(start.rotation * model.approach);
    let mut best: Option<(f64, Configuration)> = None;
    for shape in SHAPES {
        let mut at = start.clone();
        for (u, c) in at.coordinates.iter_mut().zip(&model.hand.actuation.coordinates) {
            if c.closed != c.open {
                *u += shape * (c.closed - *u);
            }
        }
        scratch.kinematics.forward(model, &at);
        let normals: Vec<Vector3<f64>> =
            model.points.iter().map(|p| scratch.kinematics.direction(p.body, &p.normal)).collect();
        let shares = balance::shares(&normals, &used, model.hand.pads.len(), EVENNESS);
        let grip: Vector3<f64> = model
            .points
            .iter()
            .zip(&shares)
            .map(|(p, w)| scratch.kinematics.point(p.body, &p.point) * *w)
            .sum();
        at.translation += target - grip;
        let began = at.translation;
        if !draw_back(objective, &mut at, &back, scratch) {
            continue;
        }
        let drawn = (at.translation - began).norm();
        close_together(objective, closers, &mut at, drawn, scratch, budget);
        let hold = hold(objective, &at, scratch);
        if hold > best.as_ref().map_or(0.0, |b| b.0) {
            best = Some((hold, at));
        }
    }
    if let Some((_, best)) = best {
        configuration.copy_from(&best);
    }
}

/// Draws the hand back until nothing of it is in the scene or too near to the table; false where that is too far.
fn draw_back(
    objective: &Objective<'_>,
    at: &mut Configuration,
    back: &Vector3<f64>,
    scratch: &mut Scratch,
) -> bool {
    let model = objective.model;
    let mut drawn = 0.0;
    loop {
        scratch.kinematics.forward(model, at);
        objective.place_spheres(scratch);
        let tolerance = FREE_VOXELS * objective.obstacles.grid.voxel_m();
        let mut deepest = f64::NEG_INFINITY;
        for (s, center) in model.spheres.iter().zip(&scratch.centers) {
            deepest = deepest.max(s.radius - objective.obstacles.scene(center).0 - tolerance);
            if let Some(table) = objective.obstacles.table_m {
                deepest = deepest.max(s.radius - (center.z - table) + TABLE_ROOM_M);
            }
        }
        if deepest <= 0.0 {
            return true;
        }
        let step = deepest + LEAST_STEP_M;
        drawn += step;
        if drawn > FARTHEST_M {
            return false;
        }
        at.translation += back * step;
    }
}

/// Closes all fingers at the same pace until each touches; the hand gives way to the table along its approach, and
/// sideways to fingers that touch before others do. It goes `ahead` by at most so many metres.
fn close_together(
    objective: &Objective<'_>,
    all: &[Closer],
    configuration: &mut Configuration,
    ahead: f64,
    scratch: &mut Scratch,
    budget: &dyn Budget,
) {
    let model = objective.model;
    let approach = configuration.rotation * model.approach;
    let near = CONTACT_VOXELS * objective.obstacles.grid.voxel_m();
    let (mut drawn, mut shifted) = (0.0, 0.0);
    let mut ahead = ahead;
    let mut before = configuration.clone();
    for _ in 0..ROUNDS {
        if budget.is_cancelled() {
            return;
        }
        let mut moved = false;
        let mut towards = Vector3::zeros();
        for closer in all {
            let now = feel(objective, configuration, closer, scratch);
            if now.all_touch() {
                towards += now.touching;
                continue;
            }
            before.copy_from(configuration);
            if !now.is_too_deep() && !closer.move_by(model, configuration, now.safe_step().min(PACE_M)) {
                continue;
            }
            let next = feel(objective, configuration, closer, scratch);
            if !next.is_too_deep() {
                moved = true;
            } else if next.on_table && drawn < DRAW_M {
                let step = next.over + SLACK_M;
                configuration.translation -= approach * step;
                drawn += step;
                moved = true;
            } else {
                configuration.copy_from(&before);
                if next.in_scene && now.gaps.iter().any(|&g| g <= near) {
                    towards += now.nearest;
                }
            }
        }
        // Those that touch wait, and the hand goes their way until the others touch too.
        let sideways = towards - approach * approach.dot(&towards);
        if shifted < SHIFT_M
            && let Some(way) = sideways.try_normalize(0.3)
        {
            before.copy_from(configuration);
            configuration.translation -= way * STEP_M;
            let free = |closer: &Closer, scratch: &mut Scratch| {
                !feel(objective, configuration, closer, scratch).is_too_deep()
            };
            if all.iter().all(|c| free(c, scratch)) {
                shifted += STEP_M;
                moved = true;
            } else {
                configuration.copy_from(&before);
            }
        }
        // Fingers that curl on lie higher again: the hand follows them down.
        if ahead > 0.0 {
            before.copy_from(configuration);
            configuration.translation += approach * STEP_M;
            if is_free(objective, configuration, scratch) {
                ahead -= STEP_M;
                moved = true;
            } else {
                configuration.copy_from(&before);
            }
        }
        if !moved {
            return;
        }
    }
}

/// True when no part of the hand is too deep in the scene or too near to the table.
fn is_free(objective: &Objective<'_>, configuration: &Configuration, scratch: &mut Scratch) -> bool {
    scratch.kinematics.forward(objective.model, configuration);
    objective.place_spheres(scratch);
    let deepest = FREE_VOXELS * objective.obstacles.grid.voxel_m();
    objective.model.spheres.iter().zip(&scratch.centers).all(|(s, center)| {
        let over_table = objective.obstacles.table_m.is_none_or(|t| center.z - s.radius >= t + TABLE_ROOM_M);
        over_table && s.radius - objective.obstacles.scene(center).0 <= deepest
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion};

    use super::*;
    use crate::budget::Unlimited;
    use crate::grid::Grid;
    use crate::hand_model::HandModel;
    use crate::objective::{Obstacles, Weights};
    use crate::orientation::align;
    use crate::rank::closing;
    use crate::refine::{Cell, CenteredCentroid, FieldCells};

    const GRID: Grid = Grid { resolution: 80, size_m: 0.4 };
    const TABLE_M: f64 = 0.1;
    /// Half of the edge of a cube that stands in the middle of the table.
    const HALF_M: f64 = 0.03;

    fn middle() -> Vector3<f64> {
        Vector3::new(0.2, 0.2, TABLE_M + HALF_M)
    }

    /// Signed distances to the cube, and which voxels are its own.
    fn cube() -> (Vec<f32>, Vec<u16>) {
        let distance = |i: usize| {
            let apart = (GRID.center(GRID.voxel(i)).coords - middle()).abs() - Vector3::repeat(HALF_M);
            apart.map(|v| v.max(0.0)).norm() + apart.max().min(0.0)
        };
        let distances: Vec<f32> = (0..GRID.len()).map(|i| distance(i) as f32).collect();
        let own = distances.iter().map(|&d| u16::from(d <= 0.0)).collect();
        (distances, own)
    }

    /// What `regrip` makes of a hand that lies wide open over a place `beside` the cube's middle: where it began, where
    /// it ended, how well it holds there, and how deep its lowest sphere is below the table.
    fn regripped(id: &str, beside: Vector3<f64>) -> (Configuration, Configuration, f64, f64) {
        let hand = graspd_hands::library::hand(id).unwrap();
        let model = HandModel::new(hand);
        let (distance, objects) = cube();
        let cells = FieldCells { grid: GRID, cells: vec![Cell::default(); GRID.len()] };
        let centroids = [CenteredCentroid {
            position: Point3::from(middle() + beside),
            weight: 1.0,
            voxel_count: 1,
            label: None,
        }];
        let objective = Objective {
            model: &model,
            cells: &cells,
            centroids: &centroids,
            obstacles: Obstacles {
                grid: GRID,
                distance: &distance,
                objects: &objects,
                table_m: Some(TABLE_M),
                boxes: Vec::new(),
            },
            weights: Weights::default(),
        };
        let mut scratch = Scratch::new(&model);
        let even = 1.0 / model.points.len() as f64;
        scratch.contacts.share.fill(even);
        let down = -Vector3::z();
        let start = Configuration {
            translation: middle() + beside - down * 0.15,
            rotation: UnitQuaternion::from_rotation_matrix(&align(&model.approach, &down)),
            coordinates: hand.actuation.coordinates.iter().map(|c| c.open).collect(),
        };
        let mut at = start.clone();
        assert_eq!(hold(&objective, &at, &mut scratch), 0.0, "{id} touches nothing from up there");
        regrip(&objective, &closing::closers(&model), &start, &mut at, &mut scratch, &Unlimited);
        let holds = hold(&objective, &at, &mut scratch);
        objective.place_spheres(&mut scratch);
        let spheres = model.spheres.iter().zip(&scratch.centers);
        let below = spheres.map(|(s, c)| TABLE_M - (c.z - s.radius)).fold(f64::NEG_INFINITY, f64::max);
        (start, at, holds, below)
    }

    #[test]
    fn hands_whose_fingers_turn_about_knuckles_take_a_cube_that_they_lay_flat_over() {
        for id in ["brunel", "leap", "robotiq-3f"] {
            let (_, _, holds, below) = regripped(id, Vector3::zeros());
            assert!(holds > 1.0, "{id}: two fingers that face each other hold: {holds}");
            assert!(below <= 0.0, "{id} is {below} m below the table");
        }
    }

    #[test]
    fn a_hand_that_finds_nothing_stays_where_it_was() {
        let (start, at, holds, _) = regripped("leap", Vector3::new(0.12, 0.0, 0.0));
        assert_eq!((holds, at.translation, at.coordinates), (0.0, start.translation, start.coordinates));
    }
}

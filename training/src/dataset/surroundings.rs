//! What a gripper must not touch: points of every object and of a tray's walls, found by place; and the table.

use graspd_sim::mesh::Mesh;
use graspd_sim::world::World;
use nalgebra::{Isometry3, Point3};

use crate::evaluate::ap::{BEHIND_M, DEPTH_M, FINGER_M, HEIGHT_M, JawGrasp, between, sample};

/// Edge of the square columns in which points are kept, metres.
const CELL_M: f64 = 0.02;
/// Columns along each side: the middle metre of the table.
const CELLS: usize = 50;

/// Points of what lies on a table, by their place on it.
#[derive(Debug)]
pub struct Surroundings {
    columns: Vec<Vec<Point3<f64>>>,
}

impl Surroundings {
    /// The points of a world: of its objects as the evaluation samples them, and of its tray.
    pub fn of(world: &World) -> Self {
        let mut all = Self { columns: vec![Vec::new(); CELLS * CELLS] };
        for id in world.ids() {
            if let (Some(object), Some(pose)) = (world.object(id), world.pose(id)) {
                all.add(&object.mesh, &pose);
            }
        }
        for (center, half) in world.settings().tray.iter().flat_map(|t| t.walls()) {
            all.add(&Mesh::cuboid(half), &Isometry3::translation(center.x, center.y, center.z));
        }
        all
    }

    fn add(&mut self, mesh: &Mesh, pose: &Isometry3<f64>) {
        for p in sample(mesh) {
            let p = pose * p;
            if let [Some(x), Some(y)] = [p.x, p.y].map(cell) {
                self.columns[x * CELLS + y].push(p);
            }
        }
    }

    /// Puts all points no further than `radius_m` from `center` along x and y into `out`, and perhaps some more.
    pub fn near(&self, center: &Point3<f64>, radius_m: f64, out: &mut Vec<Point3<f64>>) {
        out.clear();
        let range = |c: f64| clamped(c - radius_m)..=clamped(c + radius_m);
        for x in range(center.x) {
            for y in range(center.y) {
                out.extend_from_slice(&self.columns[x * CELLS + y]);
            }
        }
    }
}

fn cell(coordinate: f64) -> Option<usize> {
    let at = (coordinate / CELL_M + 0.5 * CELLS as f64).floor();
    (at >= 0.0 && at < CELLS as f64).then_some(at as usize)
}

fn clamped(coordinate: f64) -> usize {
    // A cast of a negative number gives 0.
    ((coordinate / CELL_M + 0.5 * CELLS as f64) as usize).min(CELLS - 1)
}

/// How far any part of a gripper of this opening is from a point between its finger tips, at most, metres.
pub fn reach_m(width_m: f64) -> f64 {
    (DEPTH_M + BEHIND_M + FINGER_M).hypot(0.5 * width_m + FINGER_M).hypot(0.5 * HEIGHT_M)
}

/// True when the opened gripper touches none of the points and stays above the table, whose top is the plane z = 0 here
/// (points 8 mm apart would let a finger's tip half-way through).
pub fn is_free(grasp: &JawGrasp, points: &[Point3<f64>]) -> bool {
    let (x, y) = (0.5 * HEIGHT_M, 0.5 * grasp.width_m + FINGER_M);
    let above = [-x, x].into_iter().all(|x| {
        [-y, y].into_iter().all(|y| {
            [-BEHIND_M - FINGER_M, DEPTH_M]
                .into_iter()
                .all(|z| (grasp.world_from_jaw * Point3::new(x, y, z)).z >= 0.0)
        })
    });
    above && between(grasp, points).is_some()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use graspd_sim::object::Object;
    use graspd_sim::world::{Tray, WorldSettings};
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    fn world() -> World {
        let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
        let cube = Arc::new(Object::cuboid("box", Vector3::new(0.015, 0.02, 0.025)).unwrap());
        world.add(cube.clone(), &Isometry3::translation(0.1, 0.0, 0.025));
        world.add(cube, &Isometry3::translation(-0.1, 0.0, 0.025));
        world
    }

    #[test]
    fn near_points_are_all_that_are_near() {
        let all = Surroundings::of(&world());
        let every: Vec<_> = all.columns.iter().flatten().copied().collect();
        assert!(every.len() > 1000);
        let (center, mut found) = (Point3::new(0.1, 0.05, 0.0), Vec::new());
        all.near(&center, 0.07, &mut found);
        let is_near = |p: &&Point3<f64>| (p.x - center.x).abs() < 0.07 && (p.y - center.y).abs() < 0.07;
        assert!(every.iter().filter(is_near).all(|p| found.contains(p)));
        assert!(found.len() < every.len() / 2);
        all.near(&Point3::new(9.0, -9.0, 0.0), 0.07, &mut found);
        assert!(found.is_empty());
    }

    #[test]
    fn a_gripper_around_a_box_is_free_until_it_reaches_table_box_or_wall() {
        let all = Surroundings::of(&world());
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let free = |x: f64, y: f64, tip: f64| {
            let at = Isometry3::from_parts(Vector3::new(x, y, tip + DEPTH_M).into(), down);
            let grasp = JawGrasp { world_from_jaw: at, width_m: 0.06, expected: Point3::new(x, y, tip) };
            let mut points = Vec::new();
            all.near(&Point3::new(x, y, tip), reach_m(0.06), &mut points);
            is_free(&grasp, &points)
        };
        assert!(free(0.1, 0.0, 0.005) && free(0.0, 0.0, 0.001));
        assert!(!free(0.1, 0.0, -0.001), "in the table");
        assert!(!free(0.1, 0.02, 0.005), "in the box");
        assert!(!free(0.0, 0.148, 0.005) && free(0.0, 0.148, 0.035), "in the wall, above it");
    }
}

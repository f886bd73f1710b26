//! Objects upright, side by side: packed, or spread over all the room there is.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;

use super::footprint::Footprint;
use crate::object::Object;
use crate::world::WorldSettings;

/// How close objects stand.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spacing {
    /// Half the side of the square in which they stand at most, metres.
    half_side_m: f64,
    /// Gaps between neighbours that are tried, widest first, metres.
    gaps_m: &'static [f64],
}

impl Spacing {
    /// In the middle, as close as they can be told apart.
    pub(super) const PACKED: Self = Self { half_side_m: 0.14, gaps_m: &[0.012, 0.006, 0.003] };
    /// Over the whole tray, or as much of the table, as far apart as that allows.
    pub(super) fn spread(settings: &WorldSettings) -> Self {
        let half_side_m = if settings.tray.is_some() { f64::INFINITY } else { super::MIDDLE_M };
        Self { half_side_m, gaps_m: &[0.12, 0.09, 0.06, 0.03, 0.012, 0.006, 0.003] }
    }
}

/// Places tried with each gap.
const TRIES: usize = 300;
/// How far above the table an object is let go, metres.
const CLEARANCE_M: f64 = 0.0005;

/// For each object a pose in which it stands upright and touches nothing; `None` where no free place is found.
pub(super) fn places(
    objects: &[Arc<Object>],
    settings: &WorldSettings,
    spacing: Spacing,
    rng: &mut Xoshiro256PlusPlus,
) -> Vec<Option<Isometry3<f64>>> {
    let mut half = [spacing.half_side_m; 2];
    if let Some(tray) = &settings.tray {
        half = [half[0].min(tray.width_m / 2.0 - 0.005), half[1].min(tray.length_m / 2.0 - 0.005)];
    }
    let footprints: Vec<_> =
        objects.iter().map(|o| Footprint::around(o.parts.iter().flatten().map(|p| p.xy()))).collect();
    // The large ones first, while there is room.
    let mut order: Vec<usize> = (0..objects.len()).collect();
    order.sort_by(|&a, &b| footprints[b].reach().total_cmp(&footprints[a].reach()));
    let mut taken: Vec<Footprint> = Vec::new();
    let mut out = vec![None; objects.len()];
    for index in order {
        let found = spacing.gaps_m.iter().find_map(|&gap| {
            (0..TRIES).find_map(|_| {
                let yaw = rng.random_range(0.0..TAU);
                let at = Vector2::from(half.map(|h: f64| rng.random_range(-1.0..1.0) * h));
                let footprint = footprints[index].moved(yaw, at);
                let free = footprint.is_within(half) && taken.iter().all(|t| t.is_apart(&footprint, gap));
                free.then_some((footprint, yaw, at))
            })
        });
        let Some((footprint, yaw, at)) = found else { continue };
        taken.push(footprint);
        let low = objects[index].parts.iter().flatten().map(|p| p.z).fold(0.0, f64::min);
        out[index] = Some(Isometry3::from_parts(
            Translation3::new(at.x, at.y, CLEARANCE_M - low),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        ));
    }
    out
}

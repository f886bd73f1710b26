//! Why there is no grasp, and the nearest fix with its figures.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::judge::Rejection;
use crate::grasp::{EmptyReason, NoGrasp, RejectReason};
use crate::objective::Objective;
use crate::options::PlanOptions;
use crate::refine::Features;

/// Chords are looked for through solids up to this thick, metres.
const LONGEST_CHORD_M: f64 = 0.3;
/// At most this many focal contacts are tried.
const CHORDS: usize = 600;

/// The narrowest pair of opposed focal contacts, metres: how far a hand must open to straddle anything.
///
/// From focal contacts, inwards through what is solid until the other side.
pub(crate) fn narrowest_pair(features: &Features, objective: &Objective<'_>) -> Option<f64> {
    let grid = features.grid;
    let step = 0.5 * grid.voxel_m();
    let stride = (features.focal_contacts.len() / CHORDS).max(1);
    features
        .focal_contacts
        .iter()
        .step_by(stride)
        .filter_map(|&index| {
            let start = grid.center(grid.voxel(index as usize)).coords;
            let sample = features.cells.sample(&start.into());
            let inward = Vector3::new(
                f64::from(sample.value[2]),
                f64::from(sample.value[3]),
                f64::from(sample.value[4]),
            )
            .try_normalize(1e-3)?;
            let mut entered = None;
            let mut along = 0.0;
            while along < LONGEST_CHORD_M {
                let solid = objective.obstacles.scene(&(start + inward * along)).0 <= 0.0;
                match (entered, solid) {
                    (None, true) => entered = Some(along),
                    (None, false) if along > 4.0 * grid.voxel_m() => return None,
                    (Some(first), false) => return Some(along - first),
                    _ => {}
                }
                along += step;
            }
            None
        })
        .filter(|&width| width > grid.voxel_m())
        .min_by(f64::total_cmp)
}

/// The reason and fix when every candidate was rejected.
pub(crate) fn all_rejected(
    features: &Features,
    objective: &Objective<'_>,
    options: &PlanOptions,
    rejected: &BTreeMap<RejectReason, usize>,
    nearest: &[Rejection],
) -> NoGrasp {
    let narrowest = narrowest_pair(features, objective);
    let opening = objective.model.hand.opening.map(|o| o.max_m);
    if let (Some(narrowest), Some(widest)) = (narrowest, opening)
        && narrowest > widest
    {
        return NoGrasp {
            reason: EmptyReason::HandTooSmall,
            nearest_fix: format!("widest opening {widest:.3} m, narrowest contact pair {narrowest:.3} m"),
        };
    }
    let total: usize = rejected.values().sum();
    let Some((&most, &count)) = rejected.iter().max_by_key(|(_, n)| **n) else {
        return NoGrasp {
            reason: EmptyReason::OutOfTime,
            nearest_fix: "no candidate was tried; raise the batch".into(),
        };
    };
    let by = nearest.iter().filter(|r| r.reason == most).map(|r| r.by_m).fold(f64::INFINITY, f64::min);
    let collisions: usize = rejected
        .iter()
        .filter(|(r, _)| {
            matches!(
                r,
                RejectReason::CollisionScene
                    | RejectReason::CollisionTable
                    | RejectReason::ApproachBlocked
                    | RejectReason::KeepOut
                    | RejectReason::TooWide
            )
        })
        .map(|(_, n)| n)
        .sum();
    let reason = if most == RejectReason::Unfinished {
        EmptyReason::OutOfTime
    } else if 10 * collisions >= 9 * total {
        EmptyReason::HandTooLarge
    } else {
        EmptyReason::AllRejected
    };
    let head = format!("{count} of {total} candidates: {}", most.as_str());
    let by_mm = by * 1e3;
    let span = objective.model.hand.opening.map_or_else(String::new, |o| {
        let pair = narrowest.map_or_else(String::new, |n| format!(", narrowest contact pair {n:.3} m"));
        format!("; opens from {:.3} m to {:.3} m{pair}", o.min_m, o.max_m)
    });
    let tail = match most {
        RejectReason::CollisionScene | RejectReason::TooWide => {
            format!("; the nearest is {by_mm:.1} mm too deep in the scene{span}")
        }
        RejectReason::CollisionTable => format!(
            "; the nearest is {by_mm:.1} mm too deep in the table: try a steeper reaching direction or a smaller hand"
        ),
        RejectReason::CollisionSelf => {
            format!("; the nearest overlaps itself by {by_mm:.1} mm too much: raise the batch{span}")
        }
        RejectReason::ApproachBlocked => format!(
            "; the nearest approach is blocked by {by_mm:.1} mm: allow another reaching direction or a shorter \
             pre-grasp offset than {:.3} m",
            options.pregrasp_offset_m
        ),
        RejectReason::KeepOut => format!("; the nearest is {by_mm:.1} mm inside a keep-out box"),
        RejectReason::NoForceClosure => {
            format!("; friction is {:.2}: allow more, or a wider cone of orientations", options.friction)
        }
        RejectReason::NoContact => {
            format!(
                "; fewer than two fingers reach one object: raise the batch or allow other directions{span}"
            )
        }
        RejectReason::NotTarget => "; others are nearer at hand than the target: raise the batch".into(),
        RejectReason::OutOfWorkspace => "; contacts lie at the border of the workspace: move it".into(),
        RejectReason::LowScore => format!("; min_score is {:.2}", options.min_score),
        RejectReason::OrientationLimit => "; widen the allowed orientations".into(),
        RejectReason::Unfinished => "; the budget ended first: allow more time or a smaller batch".into(),
        _ => String::new(),
    };
    NoGrasp { reason, nearest_fix: head + &tail }
}

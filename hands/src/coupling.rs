//! From actuators, adaptive joints and mimic tags to the map `q = A·u + b`.

use crate::description::{ActuatorEntry, Description, Driven};
use crate::error::Findings;
use crate::files::TOML;
use crate::urdf::Model;
use crate::{Actuation, Coordinate, CoordinateKind, JointRow, SoftCoupling};

/// Limits and postures may miss the joints' limits by this much (rounded figures).
const SLACK: f64 = 1e-4;

/// Builds the actuation. `None` when errors were recorded.
pub(crate) fn build(description: &Description, model: &Model, findings: &mut Findings) -> Option<Actuation> {
    let before = findings.errors.len();
    let tree = &model.tree;
    let mut rows: Vec<Option<JointRow>> = vec![None; tree.joints.len()];
    let mut coordinates = Vec::new();
    let mut given = Vec::new();
    for actuator in &description.actuators {
        let field = format!("actuator {:?}", actuator.name);
        if actuator.joints.is_empty() {
            findings.error(TOML, &field, "no joints", "the joints that it moves");
        }
        for Driven { joint, coefficient, offset } in &actuator.joints {
            let finite = coefficient.is_finite() && *coefficient != 0.0 && coefficient.abs() < 1e4;
            if !(finite && offset.is_finite() && offset.abs() < 1e3) {
                findings.error(
                    TOML,
                    &field,
                    format!("coefficient {coefficient}, offset {offset}"),
                    "a finite coefficient other than zero and a finite offset",
                );
                continue;
            }
            let Some(index) = find(model, joint, &field, findings) else { continue };
            let row = rows[index].get_or_insert_default();
            row.terms.push((coordinates.len(), *coefficient));
            row.offset += offset;
        }
        given.push((actuator.lower, actuator.upper));
        coordinates.push(Coordinate {
            name: actuator.name.clone(),
            kind: CoordinateKind::Actuator,
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            open: actuator.open,
            closed: actuator.closed,
            effort: effort(actuator, model),
        });
    }
    for adaptive in &description.adaptive {
        let field = format!("adaptive joint {:?}", adaptive.joint);
        let Some(index) = find(model, &adaptive.joint, &field, findings) else { continue };
        if rows[index].is_some() {
            findings.error(TOML, &field, "an actuator drives it too", "one of the two");
            continue;
        }
        rows[index] = Some(JointRow { terms: vec![(coordinates.len(), 1.0)], offset: 0.0 });
        given.push((None, None));
        coordinates.push(Coordinate {
            name: adaptive.joint.clone(),
            kind: CoordinateKind::Adaptive,
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            open: adaptive.open,
            closed: adaptive.closed,
            effort: 0.0,
        });
    }
    for i in 1..coordinates.len() {
        if coordinates[..i].iter().any(|c: &Coordinate| c.name == coordinates[i].name) {
            findings.error(
                TOML,
                format!("coordinate {:?}", coordinates[i].name),
                "the name twice",
                "unique names",
            );
        }
    }
    follow_mimics(model, &mut rows);
    let mut complete = Vec::with_capacity(rows.len());
    for (row, joint) in rows.into_iter().zip(&tree.joints) {
        if row.is_none() {
            findings.error(
                TOML,
                format!("joint {:?}", joint.name),
                "nothing moves it",
                "an actuator, an adaptive entry, or a mimic tag in the URDF",
            );
        }
        complete.push(row.unwrap_or_default());
    }
    if findings.errors.len() > before {
        return None;
    }
    limits(model, &complete, &mut coordinates, &given, findings);
    let couplings = soft(description, model, findings);
    (findings.errors.len() == before).then_some(Actuation { coordinates, rows: complete, couplings })
}

/// The actuator's effort; left out, the smallest that the URDF names for the joints it moves, else 0.
fn effort(actuator: &ActuatorEntry, model: &Model) -> f64 {
    if actuator.effort.is_finite() && actuator.effort > 0.0 {
        return actuator.effort;
    }
    let named = actuator.joints.iter().filter_map(|d| model.tree.joint(&d.joint));
    let efforts = named.map(|j| model.tree.joints[j].effort).filter(|&e| e > 0.0);
    efforts.reduce(f64::min).unwrap_or(0.0)
}

fn find(model: &Model, joint: &str, field: &str, findings: &mut Findings) -> Option<usize> {
    let index = model.tree.joint(joint);
    if index.is_none() {
        findings.error(TOML, field, format!("joint {joint:?}"), "the name of a movable joint of hand.urdf");
    }
    index
}

/// Joints that the description leaves to their mimic tags get the row of the joint that they follow.
fn follow_mimics(model: &Model, rows: &mut [Option<JointRow>]) {
    // Chains end (the URDF was checked): after as many rounds as joints all are resolved.
    for _ in 0..rows.len() {
        let mut changed = false;
        for j in 0..rows.len() {
            if rows[j].is_some() {
                continue;
            }
            let Some(mimic) = model.mimics[j] else { continue };
            if let Some(leader) = rows[mimic.joint].clone() {
                let terms = leader.terms.iter().map(|&(i, c)| (i, c * mimic.multiplier));
                let terms = terms.filter(|&(_, c)| c != 0.0).collect();
                rows[j] = Some(JointRow { terms, offset: leader.offset * mimic.multiplier + mimic.offset });
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
}

/// Coordinate limits such that every joint keeps its own.
fn limits(
    model: &Model,
    rows: &[JointRow],
    coordinates: &mut [Coordinate],
    given: &[(Option<f64>, Option<f64>)],
    findings: &mut Findings,
) {
    for (row, joint) in rows.iter().zip(&model.tree.joints) {
        if let &[(i, c)] = row.terms.as_slice() {
            let (a, b) = ((joint.lower - row.offset) / c, (joint.upper - row.offset) / c);
            coordinates[i].lower = coordinates[i].lower.max(a.min(b));
            coordinates[i].upper = coordinates[i].upper.min(a.max(b));
        }
    }
    for (coordinate, &(lower, upper)) in coordinates.iter_mut().zip(given) {
        let field = format!("actuator {:?}", coordinate.name);
        coordinate.lower = coordinate.lower.max(lower.unwrap_or(f64::NEG_INFINITY));
        coordinate.upper = coordinate.upper.min(upper.unwrap_or(f64::INFINITY));
        if !(coordinate.lower < coordinate.upper
            && coordinate.lower.is_finite()
            && coordinate.upper.is_finite())
        {
            findings.error(
                TOML,
                format!("{field} limits"),
                format!("{} to {}", coordinate.lower, coordinate.upper),
                "a range that the limits of all its joints allow (joints of several actuators need lower and upper)",
            );
            continue;
        }
        let (lower, upper) = (coordinate.lower, coordinate.upper);
        for (name, value) in [("open", &mut coordinate.open), ("closed", &mut coordinate.closed)] {
            if *value >= lower - SLACK && *value <= upper + SLACK {
                *value = value.clamp(lower, upper);
            } else {
                findings.error(TOML, format!("{field} {name}"), *value, format!("{lower:.5} to {upper:.5}"));
            }
        }
    }
    for (row, joint) in rows.iter().zip(&model.tree.joints) {
        let range = |upper: bool| {
            row.terms.iter().fold(row.offset, |sum, &(i, c)| {
                let high = (c > 0.0) == upper;
                sum + c * if high { coordinates[i].upper } else { coordinates[i].lower }
            })
        };
        let (low, high) = (range(false), range(true));
        if low < joint.lower - SLACK || high > joint.upper + SLACK {
            findings.error(
                TOML,
                format!("joint {:?}", joint.name),
                format!("driven from {low:.5} to {high:.5}"),
                format!("within its limits {:.5} to {:.5}", joint.lower, joint.upper),
            );
        }
    }
}

fn soft(description: &Description, model: &Model, findings: &mut Findings) -> Vec<SoftCoupling> {
    let mut out = Vec::new();
    for (n, entry) in description.soft_couplings.iter().enumerate() {
        let field = format!("soft coupling {n}");
        let numbers = entry.terms.iter().map(|t| t.coefficient).chain([entry.target, entry.weight]);
        if entry.terms.is_empty() || numbers.into_iter().any(|v| !v.is_finite()) || entry.weight < 0.0 {
            findings.error(
                TOML,
                &field,
                "no terms or bad numbers",
                "terms, finite numbers, weight of at least 0",
            );
            continue;
        }
        let terms: Vec<(usize, f64)> = entry
            .terms
            .iter()
            .filter_map(|t| find(model, &t.joint, &field, findings).map(|j| (j, t.coefficient)))
            .collect();
        out.push(SoftCoupling { terms, target: entry.target, weight: entry.weight });
    }
    out
}

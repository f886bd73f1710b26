//! From files to a validated hand.

use nalgebra::{Point3, Unit, Vector3};

use crate::description::{self, Description};
use crate::error::{Findings, Problems};
use crate::files::{TOML, URDF};
use crate::urdf::{self, Model};
use crate::{Confidence, Hand, HandError, HandFiles, coupling, opening, pads, self_collision, spheres};

/// Most files of a hand.
const MAX_FILES: usize = 256;

impl Hand {
    /// Reads and validates a hand from the contents of its folder.
    ///
    /// `id` becomes [`Hand::id`]. The files are not trusted: sizes, counts and every number are checked.
    /// Reading is a pure function of `id` and `files`.
    ///
    /// # Errors
    /// [`HandError::BadId`] for an id outside `[a-z][a-z0-9-]{0,62}`, [`HandError::MissingFile`] without
    /// `hand.urdf` or `hand.toml`, and [`HandError::Invalid`] with every problem that was found.
    pub fn load(id: &str, files: &HandFiles) -> Result<Self, HandError> {
        check_id(id)?;
        for file in [URDF, TOML] {
            if !files.files.contains_key(file) {
                return Err(HandError::MissingFile { file: file.to_owned() });
            }
        }
        let mut findings = Findings::default();
        match read(id, files, &mut findings) {
            Some(hand) if findings.ok() => Ok(hand),
            _ => Err(HandError::Invalid(Problems(findings.errors))),
        }
    }
}

/// Checks that an id can name a hand.
pub(crate) fn check_id(id: &str) -> Result<(), HandError> {
    let letter = |b: u8| b.is_ascii_lowercase();
    let rest = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-';
    let good = id.len() <= 63 && id.bytes().next().is_some_and(letter) && id.bytes().all(rest);
    if good { Ok(()) } else { Err(HandError::BadId { found: id.chars().take(80).collect() }) }
}

/// Reads a hand and records everything that is wrong with it. `None` when errors left no hand to speak of.
pub(crate) fn read(id: &str, files: &HandFiles, findings: &mut Findings) -> Option<Hand> {
    if files.files.len() > MAX_FILES {
        findings.error("", "files", files.files.len(), format!("at most {MAX_FILES}"));
        return None;
    }
    // Both files are read before either stops the other: one reading, all problems.
    let model = files.files.get(URDF).and_then(|bytes| urdf::read(bytes, files, findings));
    let description = files.files.get(TOML).and_then(|bytes| description::read(bytes, findings));
    assemble(id, files, &model?, &description?, findings)
}

fn assemble(
    id: &str,
    files: &HandFiles,
    model: &Model,
    description: &Description,
    findings: &mut Findings,
) -> Option<Hand> {
    let tree = model.tree.clone();
    if tree.joints.is_empty() {
        findings.error(URDF, "joints", "no movable joint", "at least one revolute or prismatic joint");
    }
    if model.collision.is_empty() {
        findings.error(URDF, "links", "no collision geometry", "at least one collision shape");
    }
    let approach = direction(description.approach, "approach", findings);
    let actuation = coupling::build(description, model, findings);
    let (fingers, pads) = pads::build(description, &tree, findings);
    if !findings.ok() {
        return None;
    }
    let actuation = actuation?;
    let rules = &description.collision;
    let spheres = spheres::cover(&tree, &model.collision, &pads, rules.tolerance_m, findings);
    let self_pairs = self_collision::pairs(&tree, &actuation, &spheres, rules, findings);
    let tool_point = match description.tool_point {
        Some(p) if p.iter().all(|v| v.is_finite() && v.abs() <= urdf::MAX_LENGTH_M) => Point3::from(p),
        Some(p) => {
            findings.error(TOML, "tool_point", format!("{p:?}"), "finite metres within ±2");
            return None;
        }
        None => opening::tool_point(&tree, &actuation, &pads),
    };
    Some(Hand {
        id: id.to_owned(),
        display_name: description.display_name.clone(),
        revision: files.revision(),
        approach: approach?,
        tool_point,
        start_offset_m: description.start_offset_m,
        candidates: pads::candidates(&pads, &tree, description.candidates.per_pad),
        opening: opening::opening(&tree, &actuation, &pads),
        confidence: description
            .confidence
            .as_ref()
            .map_or(Confidence::GENERIC, |c| Confidence { slope: c.slope, intercept: c.intercept }),
        fingers,
        pads,
        collision: model.collision.clone(),
        visuals: model.visuals.clone(),
        spheres,
        self_pairs,
        warnings: findings.warnings.iter().map(ToString::to_string).collect(),
        tree,
        actuation,
    })
}

fn direction(v: [f64; 3], key: &str, findings: &mut Findings) -> Option<Unit<Vector3<f64>>> {
    let vector = Vector3::from(v);
    let good = vector.iter().all(|c| c.is_finite() && c.abs() < 1e6) && vector.norm() > 1e-6;
    if !good {
        findings.error(TOML, key, format!("{v:?}"), "a finite direction other than zero");
        return None;
    }
    Some(Unit::new_normalize(vector))
}

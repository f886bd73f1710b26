//! `hand.toml`: what a URDF does not say about a hand. Unknown keys are errors.
//!
//! Every number that comes from outside names its origin in a `source` key or a comment.

use serde::Deserialize;

use crate::error::Findings;
use crate::files::TOML;

/// Largest `hand.toml`, bytes.
const MAX_BYTES: usize = 256 * 1024;
/// Most entries of any list.
const MAX_ENTRIES: usize = 128;
/// Larger log-odds are certainty.
const MAX_LOG_ODDS: f64 = 100.0;

/// The whole file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Description {
    /// Shown to people.
    pub(crate) display_name: String,
    /// Where the figures come from.
    #[serde(default)]
    #[expect(dead_code, reason = "documentation that travels with the figures")]
    pub(crate) source: String,
    /// Approach direction in the hand frame; any length.
    pub(crate) approach: [f64; 3],
    /// Tool point in the hand frame, metres; derived when left out.
    pub(crate) tool_point: Option<[f64; 3]>,
    /// Back-off of initial poses, metres (Supplementary Note 4).
    #[serde(default = "default_start_offset")]
    pub(crate) start_offset_m: f64,
    /// Fingers, in the order of their indices.
    pub(crate) fingers: Vec<FingerEntry>,
    /// Contact pads.
    pub(crate) pads: Vec<PadEntry>,
    /// Motors.
    pub(crate) actuators: Vec<ActuatorEntry>,
    /// Joints of underactuated fingers that contact moves.
    #[serde(default)]
    pub(crate) adaptive: Vec<AdaptiveEntry>,
    /// What adaptive mechanisms prefer.
    #[serde(default)]
    pub(crate) soft_couplings: Vec<SoftEntry>,
    /// What a grasp's figure says about its success with this hand.
    pub(crate) confidence: Option<ConfidenceEntry>,
    /// How pads are sampled.
    #[serde(default)]
    pub(crate) candidates: Candidates,
    /// How collision geometry is covered and which parts may touch.
    #[serde(default)]
    pub(crate) collision: Collision,
}

fn default_start_offset() -> f64 {
    0.05
}

/// The curve from a grasp's figure to the probability that it holds.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ConfidenceEntry {
    pub(crate) slope: f64,
    pub(crate) intercept: f64,
    /// Where the two numbers come from.
    #[serde(default)]
    #[expect(dead_code, reason = "documentation that travels with the figures")]
    pub(crate) source: String,
}

/// One finger.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FingerEntry {
    pub(crate) name: String,
}

/// One pad: either `corners`, or `center`, `half_u` and `half_v`; in the link frame, metres.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PadEntry {
    pub(crate) name: String,
    pub(crate) finger: String,
    pub(crate) link: String,
    pub(crate) center: Option<[f64; 3]>,
    pub(crate) half_u: Option<[f64; 3]>,
    pub(crate) half_v: Option<[f64; 3]>,
    /// Four corners in turn around the pad.
    pub(crate) corners: Option<[[f64; 3]; 4]>,
    /// Outward normal; checked against the edges.
    pub(crate) normal: [f64; 3],
    #[serde(default)]
    #[expect(dead_code, reason = "documentation that travels with the figures")]
    pub(crate) source: String,
}

/// One motor and the joints that it moves.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ActuatorEntry {
    pub(crate) name: String,
    pub(crate) joints: Vec<Driven>,
    pub(crate) open: f64,
    pub(crate) closed: f64,
    /// Limits; derived from the joints' limits when left out, and never wider than those.
    pub(crate) lower: Option<f64>,
    pub(crate) upper: Option<f64>,
    #[serde(default)]
    pub(crate) effort: f64,
}

/// `joint = coefficient·actuator + offset`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Driven {
    pub(crate) joint: String,
    #[serde(default = "one")]
    pub(crate) coefficient: f64,
    #[serde(default)]
    pub(crate) offset: f64,
}

/// One adaptive joint.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct AdaptiveEntry {
    pub(crate) joint: String,
    pub(crate) open: f64,
    pub(crate) closed: f64,
}

/// `Σ coefficient·joint → target`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SoftEntry {
    pub(crate) terms: Vec<SoftTerm>,
    #[serde(default)]
    pub(crate) target: f64,
    #[serde(default = "one")]
    pub(crate) weight: f64,
}

/// One summand of a soft coupling.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SoftTerm {
    pub(crate) joint: String,
    #[serde(default = "one")]
    pub(crate) coefficient: f64,
}

fn one() -> f64 {
    1.0
}

/// Sampling of the pads.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Candidates {
    /// 5 or 9; by default 9 for hands of up to three pads, else 5.
    pub(crate) per_pad: Option<usize>,
}

/// Collision rules.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Collision {
    /// How far the sphere covering may fall short of, or stick out of, the shapes, metres.
    #[serde(default = "default_tolerance")]
    pub(crate) tolerance_m: f64,
    /// Links that take no part in self-collision.
    #[serde(default)]
    pub(crate) ignore_links: Vec<String>,
    /// Pairs of links that may touch each other.
    #[serde(default)]
    pub(crate) ignore_pairs: Vec<[String; 2]>,
}

impl Default for Collision {
    fn default() -> Self {
        Self { tolerance_m: default_tolerance(), ignore_links: Vec::new(), ignore_pairs: Vec::new() }
    }
}

fn default_tolerance() -> f64 {
    0.004
}

/// What was found and what was expected, of a parser's message that says both in one sentence.
fn worded(message: &str) -> (String, String) {
    if let Some(key) = message.strip_prefix("missing field ") {
        return (format!("no {key}"), format!("{key}, which every such entry has"));
    }
    match message.split_once(", expected ") {
        Some((found, expected)) => (found.to_owned(), expected.to_owned()),
        None => (message.to_owned(), "valid TOML that describes a hand".to_owned()),
    }
}

/// Reads `hand.toml`. `None` when errors were recorded.
pub(crate) fn read(bytes: &[u8], findings: &mut Findings) -> Option<Description> {
    if bytes.len() > MAX_BYTES {
        findings.error(TOML, "file", format!("{} bytes", bytes.len()), format!("at most {MAX_BYTES} bytes"));
        return None;
    }
    let Ok(text) = std::str::from_utf8(bytes) else {
        findings.error(TOML, "text", "bytes that are not UTF-8", "a UTF-8 text");
        return None;
    };
    let description: Description = match toml::from_str(text) {
        Ok(description) => description,
        Err(error) => {
            let line = error.span().map_or(0, |s| text[..s.start.min(text.len())].matches('\n').count() + 1);
            let (found, expected) = worded(error.message());
            findings.error(TOML, format!("line {line}"), found, expected);
            return None;
        }
    };
    let before = findings.errors.len();
    let mut count = |what: &str, n: usize, least: usize| {
        if n < least || n > MAX_ENTRIES {
            findings.error(TOML, what, n, format!("{least} to {MAX_ENTRIES} entries"));
        }
    };
    count("fingers", description.fingers.len(), 1);
    count("pads", description.pads.len(), 1);
    count("actuators", description.actuators.len(), 1);
    count("adaptive", description.adaptive.len(), 0);
    count("soft_couplings", description.soft_couplings.len(), 0);
    count("collision.ignore_links", description.collision.ignore_links.len(), 0);
    count("collision.ignore_pairs", description.collision.ignore_pairs.len(), 0);
    if let Some(n) = description.candidates.per_pad
        && n != 5
        && n != 9
    {
        findings.error(TOML, "candidates.per_pad", n, "5 or 9");
    }
    let offset = description.start_offset_m;
    if !(0.0..=1.0).contains(&offset) {
        findings.error(TOML, "start_offset_m", offset, "0 to 1 metre");
    }
    if let Some(c) = &description.confidence {
        if !(c.slope > 0.0 && c.slope <= MAX_LOG_ODDS) {
            findings.error(TOML, "confidence.slope", c.slope, "more than 0, at most 100");
        }
        if !(-MAX_LOG_ODDS..=MAX_LOG_ODDS).contains(&c.intercept) {
            findings.error(TOML, "confidence.intercept", c.intercept, "-100 to 100");
        }
    }
    let tolerance = description.collision.tolerance_m;
    if !(0.001..=0.02).contains(&tolerance) {
        findings.error(TOML, "collision.tolerance_m", tolerance, "0.001 to 0.02 metres");
    }
    if description.display_name.is_empty() || description.display_name.chars().count() > 128 {
        findings.error(
            TOML,
            "display_name",
            format!("{:?}", description.display_name),
            "1 to 128 characters",
        );
    }
    (findings.errors.len() == before).then_some(description)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mistakes_read_as_sentences() {
        let said = |text: &str| {
            let mut findings = Findings::default();
            assert!(read(text.as_bytes(), &mut findings).is_none());
            findings.errors[0].to_string()
        };
        let unknown = said("display_name = \"x\"\naproach = [0, 0, 1]");
        assert!(
            unknown.starts_with("hand.toml: line 2: found unknown field `aproach`; expected one of `"),
            "{unknown}"
        );
        assert_eq!(unknown.matches("expected").count(), 1, "{unknown}");
        let missing = said("display_name = \"x\"");
        assert!(missing.contains("found no `approach`; expected `approach`, which"), "{missing}");
        let broken = said("display_name = ");
        assert_eq!(broken.matches("expected").count(), 1, "{broken}");
    }
}

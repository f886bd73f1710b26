//! The proposal as the text of a `hand.toml`, with comments on how each part was derived.

use std::fmt::Write as _;

use nalgebra::Vector3;

use super::Approach;
use super::fingers::Chain;
use super::motion::{Motion, Role};
use super::pads::PadGuess;
use crate::urdf::Model;

/// Writes the description.
pub(super) fn write(
    model: &Model,
    fingers: &[Chain],
    motion: &Motion,
    pads: &[PadGuess],
    approach: &Approach,
) -> String {
    let mut out = String::new();
    // Writing to a String cannot fail: results are dropped.
    let _ = writeln!(
        out,
        "# Proposed from hand.urdf alone. Read every comment; what is marked GUESS needs your eyes.\n\
         display_name = {}\n\
         source = \"derived from hand.urdf\"\n\n\
         # From the palm to the middle of the pads, half closed{}.\n\
         approach = {}\n\
         start_offset_m = 0.05",
        quoted("My hand"),
        if approach.snapped {
            ", snapped to an axis (sure within 25 degrees)"
        } else {
            " (GUESS: near no axis)"
        },
        vector(&approach.direction),
    );
    let _ = writeln!(out, "\n# One finger for each chain of joints that ends in a solid part.");
    for finger in fingers {
        let _ = writeln!(out, "[[fingers]]\nname = {}\n", quoted(&finger.name));
    }
    let _ =
        writeln!(out, "# One pad a finger: the face of its last part that looks along the closing motion.");
    for pad in pads {
        let finger = &fingers[pad.finger].name;
        let sure = if pad.cosine > 0.85 { "likely" } else { "GUESS" };
        let _ = writeln!(
            out,
            "# {sure}: turned {:.0} degrees from the closing direction.\n\
             [[pads]]\nname = {}\nfinger = {}\nlink = {}\ncenter = {}\nhalf_u = {}\nhalf_v = {}\nnormal = {}\n",
            pad.cosine.clamp(-1.0, 1.0).acos().to_degrees(),
            quoted(&format!("{finger} pad")),
            quoted(finger),
            quoted(&model.tree.links[pad.link].name),
            vector(&pad.center.coords),
            vector(&pad.half_u),
            vector(&pad.half_v),
            vector(&pad.normal),
        );
    }
    actuators(model, motion, &mut out);
    out
}

fn actuators(model: &Model, motion: &Motion, out: &mut String) {
    let _ = writeln!(
        out,
        "# One actuator for each joint without a mimic tag; followers are taken from the URDF.\n\
         # If one motor drives several of these joints, name them all in one actuator's `joints`."
    );
    for (j, joint) in model.tree.joints.iter().enumerate() {
        let note = match motion.roles[j] {
            Role::Follows => continue,
            Role::Closes(cosine) if cosine > 0.7 => "likely: this way fingertips come together".to_owned(),
            Role::Closes(cosine) => {
                format!("GUESS: moves fingertips together only partly (cosine {cosine:.2})")
            }
            Role::Spreads => {
                "GUESS: moves fingertips aside, so it stays put while the hand closes".to_owned()
            }
        };
        let followers: Vec<&str> = model
            .mimics
            .iter()
            .zip(&model.tree.joints)
            .filter(|(m, _)| m.is_some_and(|m| m.joint == j))
            .map(|(_, joint)| joint.name.as_str())
            .collect();
        if !followers.is_empty() {
            let _ = writeln!(out, "# Sure: joints {followers:?} follow it by their mimic tags.");
        }
        let _ = writeln!(
            out,
            "# {note}.\n[[actuators]]\nname = {}\njoints = [{{ joint = {} }}]\nopen = {}\nclosed = {}\neffort = {}\n",
            quoted(&joint.name),
            quoted(&joint.name),
            number(motion.open[j]),
            number(motion.closed[j]),
            number(joint.effort),
        );
    }
}

/// A TOML string: the names come from an untrusted file.
fn quoted(text: &str) -> String {
    toml::Value::String(text.chars().filter(|c| !c.is_control()).collect()).to_string()
}

fn number(value: f64) -> String {
    // Adding 0.0 turns -0.0 into 0.0.
    let text = format!("{:.6}", (value * 1e6).round() / 1e6 + 0.0);
    let short = text.trim_end_matches('0');
    if short.ends_with('.') { format!("{short}0") } else { short.to_owned() }
}

fn vector(v: &Vector3<f64>) -> String {
    format!("[{}, {}, {}]", number(v.x), number(v.y), number(v.z))
}

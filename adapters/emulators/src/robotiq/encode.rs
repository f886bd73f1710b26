//! Status bytes.

use super::device::Model;
use super::gripper::{Machine, Phase};
use super::plant::{AxisState, Contact};

/// The sixteen status bytes; a 2F has six.
pub(super) fn status(machine: &Machine) -> [u8; 16] {
    match machine.config.model {
        Model::TwoFinger => two_finger(machine),
        Model::ThreeFinger => three_finger(machine),
    }
}

/// 0 moving, 1 stopped while opening, 2 stopped while closing, 3 at the request.
fn object(axis: &AxisState) -> u8 {
    match (axis.moving, axis.contact) {
        (true, _) => 0,
        (false, Some(Contact::Opening)) => 1,
        (false, Some(Contact::Closing)) => 2,
        (false, None) => 3,
    }
}

fn count(value: f64) -> u8 {
    // A cast saturates.
    value.round() as u8
}

fn two_finger(machine: &Machine) -> [u8; 16] {
    let mut bytes = [0; 16];
    let [axis, ..] = &machine.axes[..] else { return bytes };
    let state = match machine.phase {
        Phase::Reset | Phase::Releasing | Phase::Stopped => 0,
        Phase::Activating(_) => 1,
        Phase::ChangingMode(_) | Phase::Ready => 3,
    };
    let activated = u8::from(machine.activation_bit());
    let goes = u8::from(machine.goes() && machine.phase == Phase::Ready);
    let object = if goes == 1 { object(axis) } else { 0 };
    bytes[0] = activated | goes << 3 | state << 4 | object << 6;
    bytes[2] = machine.fault;
    bytes[3] = machine.taken()[3];
    bytes[4] = count(axis.position);
    bytes[5] = count(axis.current);
    bytes
}

fn three_finger(machine: &Machine) -> [u8; 16] {
    let mut bytes = [0; 16];
    let state = match machine.phase {
        Phase::Reset | Phase::Releasing | Phase::Stopped => 0,
        Phase::Activating(_) => 1,
        Phase::ChangingMode(_) => 2,
        Phase::Ready => 3,
    };
    let goes = machine.goes() && machine.phase == Phase::Ready;
    let [fingers @ .., _scissor] = &machine.axes[..] else { return bytes };
    let moving = machine.axes.iter().any(|a| a.moving);
    let stopped = fingers.iter().filter(|a| a.contact.is_some()).count();
    let motion = match (moving || !goes, stopped) {
        (true, _) => 0,
        (false, 0) => 3,
        (false, 3) => 2,
        (false, _) => 1,
    };
    let activated = u8::from(machine.activation_bit());
    bytes[0] = activated | machine.taken()[0] & 0b110 | u8::from(goes) << 3 | state << 4 | motion << 6;
    for (i, axis) in machine.axes.iter().enumerate() {
        let object = if goes { object(axis) } else { 0 };
        bytes[1] |= object << (2 * i);
        let at = 3 + 3 * i;
        bytes[at] = machine.taken()[at];
        bytes[at + 1] = count(axis.position);
        bytes[at + 2] = count(axis.current / 10.0);
    }
    bytes[2] = machine.fault;
    bytes
}

//! The six bytes of a 2F.

use super::{AxisStatus, Fault, Mode, Motion, Phase, Request, Status, StatusError, length};
use crate::settings::Model;

pub(super) fn encode(request: &Request) -> Vec<u8> {
    let action = u8::from(request.activate)
        | u8::from(request.go) << 3
        | u8::from(request.release.is_some()) << 4
        | u8::from(request.release == Some(true)) << 5;
    let axis = request.axes.first().copied().unwrap_or_default();
    vec![action, 0, 0, axis.position, axis.speed, axis.force]
}

pub(super) fn decode(bytes: &[u8]) -> Result<Status, StatusError> {
    let [state, _, fault, requested, position, current] = *bytes else {
        return Err(length(bytes.len(), 6));
    };
    let phase = match state >> 4 & 3 {
        0 => Phase::Reset,
        1 => Phase::Activating,
        3 => Phase::Ready,
        found => {
            let (found, expected) = (found.to_string(), "0, 1 or 3".to_owned());
            return Err(StatusError { field: "gSTA", found, expected });
        }
    };
    Ok(Status {
        activated: state & 1 != 0,
        goes: state & 1 << 3 != 0,
        phase,
        mode: Mode::Basic,
        fault: Fault::new(fault & 0x0F, Model::TwoFinger85),
        controller_fault: fault >> 4,
        axes: vec![AxisStatus { requested, position, current, motion: Motion::from_bits(state >> 6) }],
    })
}

#[cfg(test)]
mod tests {
    use super::super::AxisRequest;
    use super::*;

    #[test]
    fn requests_are_the_published_bytes() {
        let full = AxisRequest { position: 255, speed: 255, force: 255 };
        let closing = Request { activate: true, go: true, axes: vec![full], ..Request::default() };
        assert_eq!(encode(&closing), [9, 0, 0, 0xFF, 0xFF, 0xFF]);
        assert_eq!(encode(&Request::default()), [0; 6]);
        assert_eq!(encode(&Request { activate: true, ..Request::default() }), [1, 0, 0, 0, 0, 0]);
        let release = Request { activate: true, release: Some(true), ..Request::default() };
        assert_eq!(encode(&release)[0], 0b11_0001);
    }

    #[test]
    fn status_bytes_are_read_as_published() {
        let moving = decode(&[0x39, 0, 0, 0xFF, 0x0E, 0x0A]).unwrap();
        assert!(moving.activated && moving.goes && moving.fault.is_none());
        assert_eq!((moving.phase, moving.axes[0].motion), (Phase::Ready, Motion::Moving));
        let gripped = decode(&[0xB9, 0, 0, 0xFF, 0xBD, 0]).unwrap();
        assert_eq!((gripped.axes[0].motion, gripped.axes[0].position), (Motion::HeldClosing, 0xBD));
        assert_eq!(decode(&[0x11, 0, 0, 0, 0, 0]).unwrap().phase, Phase::Activating);
        assert_eq!(decode(&[0x31, 0, 5, 0, 0, 0]).unwrap().fault.unwrap().code(), 5);
        let of_controller = decode(&[0x31, 0, 0x30, 0, 0, 0]).unwrap();
        assert!(of_controller.fault.is_none() && of_controller.controller_fault == 3);
        assert_eq!(
            decode(&[0x21, 0, 0, 0, 0, 0]).unwrap_err().to_string(),
            "gSTA: found 2, expected 0, 1 or 3"
        );
        assert_eq!(decode(&[0; 5]).unwrap_err().to_string(), "status bytes: found 5, expected 6");
    }
}

//! The sixteen bytes of a 3-Finger; the last is not used.

use super::{AxisStatus, Fault, Mode, Motion, Phase, Request, Status, StatusError, length};
use crate::settings::Model;

pub(super) fn encode(request: &Request) -> Vec<u8> {
    let mut bytes = vec![0; 16];
    bytes[0] = u8::from(request.activate)
        | request.mode.bits() << 1
        | u8::from(request.go) << 3
        | u8::from(request.release.is_some()) << 4;
    if request.individual {
        bytes[1] = 0b1100;
    }
    for (slot, axis) in bytes[3..15].chunks_exact_mut(3).zip(&request.axes) {
        slot.copy_from_slice(&[axis.position, axis.speed, axis.force]);
    }
    bytes
}

pub(super) fn decode(bytes: &[u8]) -> Result<Status, StatusError> {
    let [state, objects, fault, axes @ .., _] = bytes else { return Err(length(bytes.len(), 16)) };
    if axes.len() != 12 {
        return Err(length(bytes.len(), 16));
    }
    let phase = match state >> 4 & 3 {
        0 => Phase::Reset,
        1 => Phase::Activating,
        2 => Phase::ChangingMode,
        _ => Phase::Ready,
    };
    let axis = |(i, bytes): (usize, &[u8])| AxisStatus {
        requested: bytes[0],
        position: bytes[1],
        current: bytes[2],
        motion: Motion::from_bits(objects >> (2 * i)),
    };
    Ok(Status {
        activated: state & 1 != 0,
        goes: state & 1 << 3 != 0,
        phase,
        mode: Mode::from_bits(state >> 1),
        fault: Fault::new(fault & 0x0F, Model::ThreeFinger),
        controller_fault: 0,
        axes: axes.chunks_exact(3).enumerate().map(axis).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::AxisRequest;
    use super::*;

    #[test]
    fn requests_lie_where_the_register_table_says() {
        let axis = |n| AxisRequest { position: n, speed: n + 1, force: n + 2 };
        let request = Request {
            activate: true,
            go: true,
            mode: Mode::Pinch,
            individual: true,
            axes: vec![axis(10), axis(20), axis(30), axis(40)],
            ..Request::default()
        };
        let expected = [0b1011, 0b1100, 0, 10, 11, 12, 20, 21, 22, 30, 31, 32, 40, 41, 42, 0];
        assert_eq!(encode(&request), expected);
    }

    #[test]
    fn status_lies_where_the_register_table_says() {
        let mut bytes = [0b0111_1101, 0b11_01_10_00, 6, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 0];
        let status = decode(&bytes).unwrap();
        assert!(status.activated && status.goes);
        assert_eq!((status.phase, status.mode), (Phase::Ready, Mode::Wide));
        assert_eq!(status.fault.unwrap().code(), 6);
        let motions: Vec<Motion> = status.axes.iter().map(|a| a.motion).collect();
        assert_eq!(motions, [Motion::Moving, Motion::HeldClosing, Motion::HeldOpening, Motion::Reached]);
        let scissor = status.axes[3];
        assert_eq!((scissor.requested, scissor.position, scissor.current), (10, 11, 12));
        bytes[0] = 0b10_0001;
        assert_eq!(decode(&bytes).unwrap().phase, Phase::ChangingMode);
        assert!(decode(&bytes[..15]).is_err());
    }
}

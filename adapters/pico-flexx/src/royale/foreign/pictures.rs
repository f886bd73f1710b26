//! What the library's callbacks leave for the threads of their cameras.
//!
//! The library calls back on threads of its own, without anything that tells which camera it means: each open camera has its
//! own callback function, of which there are [`SLOTS`].

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::layout::{DepthData, DepthPoint, Listener};
use crate::settings::MOST_SIDE;

/// A point of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    pub(crate) z_m: f32,
    pub(crate) noise_m: f32,
    pub(crate) confidence: u8,
}

/// Depth of one exposure, copied out of the library.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Picture {
    pub(crate) stamp: Duration,
    pub(crate) stream: u16,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) exposure_us: Option<u32>,
    pub(crate) points: Vec<Point>,
}

/// What a callback leaves for the thread of its camera: the newest picture only.
pub(super) struct Slot {
    pub(super) state: Mutex<SlotState>,
    pub(super) came: Condvar,
}

/// The same, under its lock.
pub(super) struct SlotState {
    pub(super) used: bool,
    pub(super) newest: Option<Picture>,
    /// What the library gave that cannot be.
    pub(super) wrong: Option<String>,
}

/// Cameras that one process can have open.
pub(super) const SLOTS: usize = 4;

/// One for each camera.
pub(super) static SLOT: [Slot; SLOTS] = [const {
    Slot { state: Mutex::new(SlotState { used: false, newest: None, wrong: None }), came: Condvar::new() }
}; SLOTS];

/// The callback of each slot.
pub(super) const LISTENERS: [Listener; SLOTS] = [heard::<0>, heard::<1>, heard::<2>, heard::<3>];

/// What the callback of a slot has left.
pub(super) fn locked(slot: usize) -> MutexGuard<'static, SlotState> {
    SLOT[slot].state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The callback of a slot, on the library's thread.
extern "C" fn heard<const N: usize>(data: *const DepthData) {
    // SAFETY: the library passes one exposure, valid until this function returns; a null pointer is none.
    let Some(data) = (unsafe { data.as_ref() }) else { return };
    let picture = copy(data);
    let mut state = locked(N);
    if !state.used {
        return;
    }
    match picture {
        Ok(picture) => state.newest = Some(picture),
        Err(detail) => state.wrong = Some(detail),
    }
    SLOT[N].came.notify_one();
}

fn copy(data: &DepthData) -> Result<Picture, String> {
    let (width, height) = (usize::from(data.width), usize::from(data.height));
    let pixels = width * height;
    let sides = (1..=MOST_SIDE).contains(&width) && (1..=MOST_SIDE).contains(&height);
    if !sides || data.nr_points as usize != pixels || data.points.is_null() {
        let points = data.nr_points;
        return Err(format!("found {points} points of {width} x {height} pixels, expected all"));
    }
    if data.points.align_offset(align_of::<DepthPoint>()) != 0 {
        return Err("found points that are not aligned".into());
    }
    // SAFETY: not null and aligned; the library gives `nr_points` points, which live until the callback returns.
    let points = unsafe { std::slice::from_raw_parts(data.points, pixels) };
    let exposure_us = if data.exposure_times.is_null() || data.nr_exposure_times == 0 {
        None
    } else {
        // SAFETY: not null, and there is at least one; read without asking for alignment.
        Some(unsafe { data.exposure_times.read_unaligned() })
    };
    let kept = |p: &DepthPoint| Point { z_m: p.z, noise_m: p.noise, confidence: p.depth_confidence };
    Ok(Picture {
        stamp: Duration::from_micros(u64::try_from(data.timestamp).unwrap_or(0)),
        stream: data.stream_id,
        width,
        height,
        exposure_us,
        points: points.iter().map(kept).collect(),
    })
}

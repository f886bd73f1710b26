//! An open camera of the library.

use std::ffi::{CStr, CString, c_int};
use std::ptr;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use super::layout::LensParameters;
use super::pictures::{LISTENERS, Picture, SLOT, locked};
use super::{OK, Royale};
use crate::royale::RoyaleError;

/// Exposure modes.
const MANUAL: c_int = 0;
const AUTOMATIC: c_int = 1;

/// An open camera. Stopped and destroyed when dropped.
pub(crate) struct Camera {
    pub(super) royale: Arc<Royale>,
    pub(super) handle: u64,
    pub(super) slot: usize,
    pub(super) listens: bool,
    pub(super) captures: bool,
    pub(super) id: String,
}

/// Numbers of a lens: principal point, focal lengths, tangential, radial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RoyaleLens {
    pub(crate) c: [f32; 2],
    pub(crate) f: [f32; 2],
    pub(crate) p: [f32; 2],
    pub(crate) k: [f32; 3],
}

impl Camera {
    /// Its id.
    pub(crate) fn id(&self) -> &str {
        &self.id
    }

    pub(super) fn done(&self, function: &'static str, status: c_int) -> Result<(), RoyaleError> {
        if status == OK { Ok(()) } else { Err(RoyaleError::Failed { function, status }) }
    }

    /// The use cases that it has.
    pub(crate) fn use_cases(&self) -> Result<Vec<String>, RoyaleError> {
        let (mut list, mut count) = (ptr::null_mut(), 0u32);
        // SAFETY: the camera is alive; both places live through the call.
        let status = unsafe { (self.royale.functions.use_cases)(self.handle, &mut list, &mut count) };
        self.done("royale_camera_device_get_use_cases", status)?;
        Ok(self.royale.strings(list, count))
    }

    /// Takes a use case; then the one that the camera says it has.
    pub(crate) fn take_use_case(&mut self, name: &str) -> Result<String, RoyaleError> {
        const FUNCTION: &str = "royale_camera_device_set_use_case";
        let Ok(text) = CString::new(name) else {
            let detail = format!("{name:?} has a zero");
            return Err(RoyaleError::Impossible { function: FUNCTION, detail });
        };
        // SAFETY: the camera is alive, the text ends with a zero and lives through the call.
        self.done(FUNCTION, unsafe { (self.royale.functions.set_use_case)(self.handle, text.as_ptr()) })?;
        let mut current = ptr::null_mut();
        // SAFETY: the camera is alive, `current` lives through the call.
        let status = unsafe { (self.royale.functions.current_use_case)(self.handle, &mut current) };
        self.done("royale_camera_device_get_current_use_case", status)?;
        if current.is_null() {
            return Ok(name.to_owned());
        }
        // SAFETY: a string of the library ends with a zero; it is freed once, after it was copied.
        unsafe {
            let name = CStr::from_ptr(current).to_string_lossy().into_owned();
            (self.royale.functions.free_string)(current);
            Ok(name)
        }
    }

    /// Width and height, pixels.
    pub(crate) fn size(&self) -> Result<(usize, usize), RoyaleError> {
        let (mut width, mut height) = (0u16, 0u16);
        // SAFETY: the camera is alive; both places live through the calls.
        let status = unsafe { (self.royale.functions.sensor_width)(self.handle, &mut width) };
        self.done("royale_camera_device_get_max_sensor_width", status)?;
        // SAFETY: as above.
        let status = unsafe { (self.royale.functions.sensor_height)(self.handle, &mut height) };
        self.done("royale_camera_device_get_max_sensor_height", status)?;
        Ok((usize::from(width), usize::from(height)))
    }

    /// Its lens.
    pub(crate) fn lens(&self) -> Result<RoyaleLens, RoyaleError> {
        const FUNCTION: &str = "royale_camera_device_get_lens_parameters";
        let mut lens = LensParameters {
            principal_point: [0.0; 2],
            focal_length: [0.0; 2],
            tangential: [0.0; 2],
            radial: ptr::null_mut(),
            nr_radial: 0,
        };
        // SAFETY: the camera is alive; `lens` has the library's layout and lives through the call.
        self.done(FUNCTION, unsafe { (self.royale.functions.lens)(self.handle, &mut lens) })?;
        if lens.radial.is_null() || lens.nr_radial < 3 {
            let detail = format!("found {} radial coefficients, expected 3", lens.nr_radial);
            return Err(RoyaleError::Impossible { function: FUNCTION, detail });
        }
        // SAFETY: the library gave at least three numbers there. They are twelve bytes of the library's own heap and stay
        // there: the function that frees them is not in every version.
        let k = unsafe { lens.radial.cast::<[f32; 3]>().read_unaligned() };
        Ok(RoyaleLens { c: lens.principal_point, f: lens.focal_length, p: lens.tangential, k })
    }

    /// Lets the library choose the exposure.
    pub(crate) fn expose_automatically(&mut self, stream: u16) -> Result<(), RoyaleError> {
        // SAFETY: the camera is alive.
        let status = unsafe { (self.royale.functions.set_exposure_mode)(self.handle, stream, AUTOMATIC) };
        self.done("royale_camera_device_set_exposure_mode", status)
    }

    /// Sets the exposure; then the limits, where it lies outside them.
    pub(crate) fn expose(&mut self, stream: u16, us: u32) -> Result<Result<(), (u32, u32)>, RoyaleError> {
        let (mut least, mut most) = (0u32, 0u32);
        let f = &self.royale.functions;
        // SAFETY: the camera is alive, both places live through the call.
        let status = unsafe { (f.exposure_limits)(self.handle, stream, &mut least, &mut most) };
        self.done("royale_camera_device_get_exposure_limits", status)?;
        if !(least..=most).contains(&us) {
            return Ok(Err((least, most)));
        }
        // SAFETY: the camera is alive.
        let status = unsafe { (f.set_exposure_mode)(self.handle, stream, MANUAL) };
        self.done("royale_camera_device_set_exposure_mode", status)?;
        // SAFETY: the camera is alive.
        let status = unsafe { (f.set_exposure_time)(self.handle, stream, us) };
        self.done("royale_camera_device_set_exposure_time", status)?;
        Ok(Ok(()))
    }

    /// Sets the frame rate; then the highest, where it lies above that.
    pub(crate) fn take_frame_rate(&mut self, hz: u16) -> Result<Result<(), u16>, RoyaleError> {
        let mut most = 0u16;
        // SAFETY: the camera is alive, `most` lives through the call.
        let status = unsafe { (self.royale.functions.max_frame_rate)(self.handle, &mut most) };
        self.done("royale_camera_device_get_max_frame_rate", status)?;
        if hz > most {
            return Ok(Err(most));
        }
        // SAFETY: the camera is alive.
        let status = unsafe { (self.royale.functions.set_frame_rate)(self.handle, hz) };
        self.done("royale_camera_device_set_frame_rate", status)?;
        Ok(Ok(()))
    }

    /// Starts streaming into this camera's slot.
    pub(crate) fn start(&mut self) -> Result<(), RoyaleError> {
        let f = &self.royale.functions;
        // SAFETY: the camera is alive; the listener is a function of this program, and nobody else's slot.
        let status = unsafe { (f.listen)(self.handle, LISTENERS[self.slot]) };
        self.listens = status == OK;
        self.done("royale_camera_device_register_data_listener", status)?;
        // SAFETY: the camera is alive.
        let status = unsafe { (f.start)(self.handle) };
        self.captures = status == OK;
        self.done("royale_camera_device_start_capture", status)
    }

    /// Whether the library still has the camera.
    pub(crate) fn is_connected(&self) -> Result<bool, RoyaleError> {
        let mut connected = 0u8;
        // SAFETY: the camera is alive. A C `bool` is one byte; it is read as a number, whatever the library writes.
        let status = unsafe {
            (self.royale.functions.is_connected)(self.handle, ptr::from_mut(&mut connected).cast())
        };
        self.done("royale_camera_device_is_connected", status)?;
        Ok(connected != 0)
    }

    /// Waits for the newest picture; `None` when none came in time.
    pub(crate) fn next(&mut self, timeout: Duration) -> Result<Option<Picture>, RoyaleError> {
        let state = locked(self.slot);
        let waited = SLOT[self.slot]
            .came
            .wait_timeout_while(state, timeout, |state| state.newest.is_none() && state.wrong.is_none());
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if let Some(detail) = state.wrong.take() {
            return Err(RoyaleError::Impossible { function: "the data listener", detail });
        }
        Ok(state.newest.take())
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        let f = &self.royale.functions;
        if self.captures {
            // SAFETY: the camera is alive. Not within a callback, where this must not be called.
            let _status = unsafe { (f.stop)(self.handle) };
        }
        if self.listens {
            // SAFETY: as above.
            let _status = unsafe { (f.unlisten)(self.handle) };
        }
        if self.handle != 0 {
            // SAFETY: alive, and destroyed once.
            unsafe { (f.destroy)(self.handle) }
        }
        let mut state = locked(self.slot);
        (state.used, state.newest, state.wrong) = (false, None, None);
    }
}

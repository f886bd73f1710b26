//! The functions of `libroyaleCAPI` that are used, and everything unsafe of this crate.
//!
//! The library calls back on threads of its own, without anything that tells which camera it means: each open camera has its
//! own callback function, of which there are [`SLOTS`].

#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char, c_int, c_longlong};
use std::mem::ManuallyDrop;
use std::path::Path;
use std::ptr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use libloading::Library;

use super::RoyaleError;
use crate::settings::MOST_SIDE;

const OK: c_int = 0;
/// Most strings of a list and characters of a string that are read.
const MOST_STRINGS: u32 = 256;
/// Exposure modes.
const MANUAL: c_int = 0;
const AUTOMATIC: c_int = 1;

/// A point as the library has it: 20 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
struct DepthPoint {
    x: f32,
    y: f32,
    z: f32,
    noise: f32,
    gray_value: u16,
    depth_confidence: u8,
}

/// Depth of one exposure as the library has it.
#[repr(C)]
struct DepthData {
    version: c_int,
    timestamp: c_longlong,
    stream_id: u16,
    width: u16,
    height: u16,
    exposure_times: *const u32,
    nr_exposure_times: u32,
    points: *const DepthPoint,
    nr_points: u32,
}

/// Lens as the library has it.
#[repr(C)]
struct LensParameters {
    principal_point: [f32; 2],
    focal_length: [f32; 2],
    tangential: [f32; 2],
    radial: *mut f32,
    nr_radial: u32,
}

const _: () = assert!(size_of::<DepthPoint>() == 20);
#[cfg(target_pointer_width = "64")]
const _: () = assert!(size_of::<DepthData>() == 56 && size_of::<LensParameters>() == 40);

type Listener = extern "C" fn(*const DepthData);

macro_rules! functions {
    ($($name:ident: $symbol:literal, fn($($argument:ty),*) $(-> $result:ty)?;)*) => {
        /// The functions, by name.
        struct Functions {
            $($name: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
        }

        impl Functions {
            /// Looks every function up.
            fn find(library: &Library) -> Result<Self, String> {
                Ok(Self {
                    $($name: {
                        // SAFETY: the type is that of the function in the headers of Royale 3; the pointer is only kept
                        // beside the library that it points into.
                        let found = unsafe {
                            library.get::<unsafe extern "C" fn($($argument),*) $(-> $result)?>($symbol)
                        };
                        *found.map_err(|error| format!("it is no Royale 3: {error}"))?
                    },)*
                })
            }
        }
    };
}

functions! {
    version: b"royale_get_version_v220", fn(*mut u32, *mut u32, *mut u32);
    manager_create: b"royale_camera_manager_create", fn() -> u64;
    manager_destroy: b"royale_camera_manager_destroy", fn(u64);
    connected: b"royale_camera_manager_get_connected_cameras", fn(u64, *mut u32) -> *mut *mut c_char;
    create_camera: b"royale_camera_manager_create_camera", fn(u64, *const c_char) -> u64;
    free_strings: b"royale_free_string_array", fn(*mut *mut c_char, u32);
    free_string: b"royale_free_string", fn(*mut c_char);
    initialize: b"royale_camera_device_initialize_v210", fn(u64) -> c_int;
    destroy: b"royale_camera_device_destroy_v210", fn(u64);
    use_cases: b"royale_camera_device_get_use_cases_v220", fn(u64, *mut *mut *mut c_char, *mut u32) -> c_int;
    set_use_case: b"royale_camera_device_set_use_case_v210", fn(u64, *const c_char) -> c_int;
    current_use_case: b"royale_camera_device_get_current_use_case_v220", fn(u64, *mut *mut c_char) -> c_int;
    set_exposure_mode: b"royale_camera_device_set_exposure_mode_v300", fn(u64, u16, c_int) -> c_int;
    set_exposure_time: b"royale_camera_device_set_exposure_time_v300", fn(u64, u16, u32) -> c_int;
    exposure_limits: b"royale_camera_device_get_exposure_limits_v300", fn(u64, u16, *mut u32, *mut u32) -> c_int;
    sensor_width: b"royale_camera_device_get_max_sensor_width_v220", fn(u64, *mut u16) -> c_int;
    sensor_height: b"royale_camera_device_get_max_sensor_height_v220", fn(u64, *mut u16) -> c_int;
    lens: b"royale_camera_device_get_lens_parameters_v210", fn(u64, *mut LensParameters) -> c_int;
    listen: b"royale_camera_device_register_data_listener_v210", fn(u64, Listener) -> c_int;
    unlisten: b"royale_camera_device_unregister_data_listener_v210", fn(u64) -> c_int;
    start: b"royale_camera_device_start_capture_v210", fn(u64) -> c_int;
    stop: b"royale_camera_device_stop_capture_v210", fn(u64) -> c_int;
    is_connected: b"royale_camera_device_is_connected_v220", fn(u64, *mut bool) -> c_int;
    set_frame_rate: b"royale_camera_device_set_frame_rate_v210", fn(u64, u16) -> c_int;
    max_frame_rate: b"royale_camera_device_get_max_frame_rate_v220", fn(u64, *mut u16) -> c_int;
}

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
struct Slot {
    state: Mutex<SlotState>,
    came: Condvar,
}

struct SlotState {
    used: bool,
    newest: Option<Picture>,
    /// What the library gave that cannot be.
    wrong: Option<String>,
}

/// Cameras that one process can have open.
pub(crate) const SLOTS: usize = 4;

static SLOT: [Slot; SLOTS] = [const {
    Slot { state: Mutex::new(SlotState { used: false, newest: None, wrong: None }), came: Condvar::new() }
}; SLOTS];

const LISTENERS: [Listener; SLOTS] = [heard::<0>, heard::<1>, heard::<2>, heard::<3>];

fn locked(slot: usize) -> MutexGuard<'static, SlotState> {
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

/// The loaded library.
pub(crate) struct Royale {
    functions: Functions,
    version: [u32; 3],
    /// Keeps the functions where they are. Never unloaded: the library's threads may still be in it when the last camera is
    /// closed, and a second load of it is the same one.
    _library: ManuallyDrop<Library>,
}

impl Royale {
    /// Loads one file.
    pub(crate) fn load(path: &Path) -> Result<Self, String> {
        // SAFETY: loading runs the library's initializers. A person named this file, or it has the library's name in a place
        // of the system; nothing else is loaded.
        let library = unsafe { Library::new(path) }.map_err(|error| error.to_string())?;
        let functions = Functions::find(&library)?;
        let mut version = [0u32; 3];
        let [major, minor, patch] = &mut version;
        // SAFETY: three places that live through the call.
        unsafe { (functions.version)(major, minor, patch) };
        Ok(Self { functions, version, _library: ManuallyDrop::new(library) })
    }

    /// Version of the library.
    pub(crate) fn version(&self) -> [u32; 3] {
        self.version
    }

    /// Takes a list of strings over, and frees it.
    fn strings(&self, list: *mut *mut c_char, count: u32) -> Vec<String> {
        if list.is_null() {
            return Vec::new();
        }
        let mut strings = Vec::new();
        for i in 0..count.min(MOST_STRINGS) {
            // SAFETY: the library gave a list of `count` strings.
            let text = unsafe { *list.add(i as usize) };
            if !text.is_null() {
                // SAFETY: a string of the library ends with a zero.
                strings.push(unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned());
            }
        }
        // SAFETY: the list came from the library with this count, and is not used any more.
        unsafe { (self.functions.free_strings)(list, count) };
        strings
    }

    /// Ids of the cameras at this machine, and the one that was asked for, opened and initialized.
    pub(crate) fn open(self: &Arc<Self>, wanted: Option<&str>) -> Result<Option<Camera>, RoyaleError> {
        const FUNCTION: &str = "royale_camera_manager_create_camera";
        // SAFETY: takes nothing.
        let manager = unsafe { (self.functions.manager_create)() };
        if manager == 0 {
            let detail = "the library makes no camera manager".into();
            return Err(RoyaleError::Impossible { function: "royale_camera_manager_create", detail });
        }
        let manager = Manager { royale: self.clone(), handle: manager };
        let id = match wanted {
            Some(id) => id.to_owned(),
            None => match manager.cameras().into_iter().next() {
                Some(id) => id,
                None => return Ok(None),
            },
        };
        let Ok(text) = CString::new(id.clone()) else {
            return Err(RoyaleError::Impossible { function: FUNCTION, detail: format!("{id:?} has a zero") });
        };
        let Some(slot) = (0..SLOTS).find(|slot| !std::mem::replace(&mut locked(*slot).used, true)) else {
            let detail = format!("{SLOTS} cameras are open in this process already");
            return Err(RoyaleError::Impossible { function: FUNCTION, detail });
        };
        {
            let mut state = locked(slot);
            (state.newest, state.wrong) = (None, None);
        }
        // SAFETY: the manager is alive, the text ends with a zero and lives through the call.
        let handle = unsafe { (self.functions.create_camera)(manager.handle, text.as_ptr()) };
        // From here on the slot is given back, and the camera destroyed, when this is dropped.
        let camera = Camera { royale: self.clone(), handle, slot, listens: false, captures: false, id };
        if handle == 0 {
            let id = camera.id.clone();
            let detail = format!("camera {id:?} cannot be opened (another process may have it)");
            return Err(RoyaleError::Impossible { function: FUNCTION, detail });
        }
        // SAFETY: the camera is alive.
        camera.done("royale_camera_device_initialize", unsafe { (self.functions.initialize)(handle) })?;
        Ok(Some(camera))
    }
}

struct Manager {
    royale: Arc<Royale>,
    handle: u64,
}

impl Manager {
    fn cameras(&self) -> Vec<String> {
        let mut count = 0u32;
        // SAFETY: the manager is alive, `count` lives through the call.
        let list = unsafe { (self.royale.functions.connected)(self.handle, &mut count) };
        self.royale.strings(list, count)
    }
}

impl Drop for Manager {
    fn drop(&mut self) {
        // SAFETY: alive, and destroyed once. Cameras outlive their manager, as in the library's own examples.
        unsafe { (self.royale.functions.manager_destroy)(self.handle) }
    }
}

/// An open camera. Stopped and destroyed when dropped.
pub(crate) struct Camera {
    royale: Arc<Royale>,
    handle: u64,
    slot: usize,
    listens: bool,
    captures: bool,
    id: String,
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

    fn done(&self, function: &'static str, status: c_int) -> Result<(), RoyaleError> {
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

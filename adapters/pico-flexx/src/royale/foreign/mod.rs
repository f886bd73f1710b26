//! The functions of `libroyaleCAPI` that are used, and everything unsafe of this crate.

#![allow(unsafe_code)]

mod camera;
mod layout;
mod pictures;

use std::ffi::{CStr, CString, c_char, c_int};
use std::mem::ManuallyDrop;
use std::path::Path;
use std::sync::Arc;

use graspd_adapters_core::foreign_functions;
use libloading::Library;

use self::layout::{LensParameters, Listener};
use self::pictures::{SLOTS, locked};
use super::RoyaleError;

pub(crate) use self::camera::Camera;
pub(crate) use self::pictures::{Picture, Point};

const OK: c_int = 0;
/// Most strings of a list and characters of a string that are read.
const MOST_STRINGS: u32 = 256;

foreign_functions! {
    "it is no Royale 3";
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

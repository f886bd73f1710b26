//! The functions of `libk4a` that are used, and everything unsafe of this crate.
//!
//! The interface is that of version 1.4 (`k4a.h`, `k4atypes.h`). What lies behind each handle is freed when its owner here is
//! dropped; owners keep the library loaded.

#![allow(unsafe_code)]

use std::ffi::{CStr, c_char, c_int, c_void};
use std::mem::ManuallyDrop;
use std::path::Path;
use std::ptr;
use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::foreign_functions;
use libloading::Library;

use super::{SdkError, log};

const OK: c_int = 0;
const TIMED_OUT: c_int = 2;
const TOO_SMALL: c_int = 2;
/// Format of depth images.
const DEPTH16: c_int = 4;
/// Severity up to which lines are kept for errors.
const LOG_ERROR: c_int = 1;
const LOG_WARNING: c_int = 2;
/// Longest serial number and calibration that are read.
const MOST_SERIAL: usize = 256;
const MOST_CALIBRATION: usize = crate::calibration::MAX_BYTES;
/// Largest side of an image that is believed.
const MOST_PIXELS: c_int = 8192;

type Handle = *mut c_void;
type LogCallback = extern "C" fn(*mut c_void, c_int, *const c_char, c_int, *const c_char);

/// `k4a_device_configuration_t`, 36 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Configuration {
    color_format: i32,
    color_resolution: i32,
    depth_mode: i32,
    camera_fps: i32,
    synchronized_images_only: bool,
    depth_delay_off_color_usec: i32,
    wired_sync_mode: i32,
    subordinate_delay_off_master_usec: u32,
    disable_streaming_indicator: bool,
}

const _: () = assert!(size_of::<Configuration>() == 36);

impl Configuration {
    /// Depth only.
    pub(crate) fn depth(mode: crate::mode::DepthMode, rate: crate::mode::FrameRate, dark: bool) -> Self {
        Self {
            color_format: 0,
            color_resolution: 0,
            depth_mode: mode.code(),
            camera_fps: rate.code(),
            synchronized_images_only: false,
            depth_delay_off_color_usec: 0,
            wired_sync_mode: 0,
            subordinate_delay_off_master_usec: 0,
            disable_streaming_indicator: dark,
        }
    }
}

foreign_functions! {
    "it is no libk4a 1.4";
    installed: b"k4a_device_get_installed_count", fn() -> u32;
    open: b"k4a_device_open", fn(u32, *mut Handle) -> c_int;
    close: b"k4a_device_close", fn(Handle);
    serial: b"k4a_device_get_serialnum", fn(Handle, *mut c_char, *mut usize) -> c_int;
    raw_calibration: b"k4a_device_get_raw_calibration", fn(Handle, *mut u8, *mut usize) -> c_int;
    start: b"k4a_device_start_cameras", fn(Handle, *const Configuration) -> c_int;
    stop: b"k4a_device_stop_cameras", fn(Handle);
    capture: b"k4a_device_get_capture", fn(Handle, *mut Handle, i32) -> c_int;
    capture_create: b"k4a_capture_create", fn(*mut Handle) -> c_int;
    capture_set_depth: b"k4a_capture_set_depth_image", fn(Handle, Handle);
    capture_depth: b"k4a_capture_get_depth_image", fn(Handle) -> Handle;
    capture_temperature: b"k4a_capture_get_temperature_c", fn(Handle) -> f32;
    capture_release: b"k4a_capture_release", fn(Handle);
    image_create: b"k4a_image_create", fn(c_int, c_int, c_int, c_int, *mut Handle) -> c_int;
    image_release: b"k4a_image_release", fn(Handle);
    image_buffer: b"k4a_image_get_buffer", fn(Handle) -> *mut u8;
    image_size: b"k4a_image_get_size", fn(Handle) -> usize;
    image_format: b"k4a_image_get_format", fn(Handle) -> c_int;
    image_width: b"k4a_image_get_width_pixels", fn(Handle) -> c_int;
    image_height: b"k4a_image_get_height_pixels", fn(Handle) -> c_int;
    image_stride: b"k4a_image_get_stride_bytes", fn(Handle) -> c_int;
    image_device_us: b"k4a_image_get_device_timestamp_usec", fn(Handle) -> u64;
    image_set_device_us: b"k4a_image_set_device_timestamp_usec", fn(Handle, u64);
    set_log: b"k4a_set_debug_message_handler", fn(Option<LogCallback>, *mut c_void, c_int) -> c_int;
}

/// The loaded library.
pub(crate) struct Sdk {
    functions: Functions,
    /// Keeps the functions where they are. Never unloaded: the library's threads may still be in it when the last handle is
    /// closed, and a second load of it is the same one.
    _library: ManuallyDrop<Library>,
}

impl std::fmt::Debug for Sdk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Sdk")
    }
}

/// A depth image, copied out of the library.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Depth {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Row major, millimetres.
    pub(crate) mm: Vec<u16>,
    /// Middle of the exposure on the device's clock.
    pub(crate) stamp: Duration,
    /// Temperature of the device, degrees Celsius; not a number where it does not say.
    pub(crate) temperature_c: f32,
}

impl Sdk {
    /// Loads one file.
    pub(crate) fn load(path: &Path) -> Result<Self, String> {
        // SAFETY: loading runs the library's initializers. A person named this file, or it has the library's name in a place
        // of the system; nothing else is loaded.
        let library = unsafe { Library::new(path) }.map_err(|error| error.to_string())?;
        let functions = Functions::find(&library)?;
        Ok(Self { functions, _library: ManuallyDrop::new(library) })
    }

    /// Sends warnings and errors of the library to [`log::heard`].
    pub(crate) fn listen_to_log(&self) {
        extern "C" fn heard(
            _: *mut c_void,
            level: c_int,
            _: *const c_char,
            _: c_int,
            message: *const c_char,
        ) {
            if message.is_null() {
                return;
            }
            // SAFETY: the library passes a text that ends with a zero and lives until this function returns.
            let text = unsafe { CStr::from_ptr(message) };
            log::heard(level <= LOG_ERROR, &text.to_string_lossy());
        }
        // SAFETY: `heard` is a function of this program and lives as long as it; it keeps nothing and does not unwind.
        let answer = unsafe { (self.functions.set_log)(Some(heard), ptr::null_mut(), LOG_WARNING) };
        if answer != OK {
            tracing::debug!("libk4a keeps its log to itself");
        }
    }

    fn failed(function: &'static str) -> SdkError {
        SdkError::Failed { function, log: log::take() }
    }

    /// Devices on the bus.
    pub(crate) fn installed(&self) -> u32 {
        // SAFETY: takes nothing.
        unsafe { (self.functions.installed)() }
    }

    /// Opens a device.
    pub(crate) fn open(self: &Arc<Self>, index: u32) -> Result<Device, SdkError> {
        let mut handle = ptr::null_mut();
        let _before = log::take();
        // SAFETY: `handle` lives through the call.
        let answer = unsafe { (self.functions.open)(index, &mut handle) };
        if answer != OK || handle.is_null() {
            return Err(Self::failed("k4a_device_open"));
        }
        Ok(Device { sdk: self.clone(), handle, streams: false })
    }

    /// Makes an image, puts it into a capture, reads it back: shows that the functions are those that are meant.
    pub(crate) fn try_images(self: &Arc<Self>) -> Result<(), SdkError> {
        const FUNCTION: &str = "k4a_image_create";
        let (width, height) = (16usize, 4usize);
        let mut image = ptr::null_mut();
        // SAFETY: `image` lives through the call.
        let answer = unsafe { (self.functions.image_create)(DEPTH16, 16, 4, 32, &mut image) };
        if answer != OK || image.is_null() {
            return Err(Self::failed(FUNCTION));
        }
        let image = Image { sdk: self.clone(), handle: image };
        let mut capture = ptr::null_mut();
        // SAFETY: `capture` lives through the call.
        let answer = unsafe { (self.functions.capture_create)(&mut capture) };
        if answer != OK || capture.is_null() {
            return Err(Self::failed("k4a_capture_create"));
        }
        let capture = Capture { sdk: self.clone(), handle: capture };
        let expected: Vec<u16> = (0..width * height).map(|i| 500 + i as u16).collect();
        // SAFETY: the library made this image with 4 rows of 32 bytes; its buffer is written within its size, which is asked
        // for first. Image and capture are alive.
        unsafe {
            let size = (self.functions.image_size)(image.handle);
            let buffer = (self.functions.image_buffer)(image.handle);
            if buffer.is_null() || size != width * height * 2 {
                let detail = format!("found {size} bytes, expected {}", width * height * 2);
                return Err(SdkError::Impossible { function: FUNCTION, detail });
            }
            for (i, value) in expected.iter().enumerate() {
                let [low, high] = value.to_ne_bytes();
                buffer.add(2 * i).write(low);
                buffer.add(2 * i + 1).write(high);
            }
            (self.functions.image_set_device_us)(image.handle, 1_234_567);
            (self.functions.capture_set_depth)(capture.handle, image.handle);
        }
        let found = capture.depth()?;
        let Some(found) = found else {
            let detail = "no image where one was set".into();
            return Err(SdkError::Impossible { function: "k4a_capture_get_depth_image", detail });
        };
        let same = found.mm == expected && found.stamp == Duration::from_micros(1_234_567);
        if !same {
            let detail = "an image came back changed".into();
            return Err(SdkError::Impossible { function: "k4a_image_get_buffer", detail });
        }
        Ok(())
    }
}

/// An open device. Closed when dropped.
pub(crate) struct Device {
    sdk: Arc<Sdk>,
    handle: Handle,
    streams: bool,
}

// SAFETY: the library's handles may be used on any thread; this one is used on one at a time, as all methods that matter
// take `&mut self` or are called by the one thread that owns it.
unsafe impl Send for Device {}

impl Device {
    /// Its serial number.
    pub(crate) fn serial(&self) -> Result<String, SdkError> {
        const FUNCTION: &str = "k4a_device_get_serialnum";
        let bytes = self.sized(FUNCTION, MOST_SERIAL, |buffer, size| {
            // SAFETY: the device is open; `buffer` is null or has `size` bytes, both live through the call.
            unsafe { (self.sdk.functions.serial)(self.handle, buffer.cast(), size) }
        })?;
        let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
        Ok(String::from_utf8_lossy(&bytes[..end]).into_owned())
    }

    /// The text of its calibration.
    pub(crate) fn raw_calibration(&self) -> Result<Vec<u8>, SdkError> {
        self.sized("k4a_device_get_raw_calibration", MOST_CALIBRATION, |buffer, size| {
            // SAFETY: as in `serial`.
            unsafe { (self.sdk.functions.raw_calibration)(self.handle, buffer, size) }
        })
    }

    /// Asks for a size, then for that many bytes.
    fn sized(
        &self,
        function: &'static str,
        most: usize,
        ask: impl Fn(*mut u8, *mut usize) -> c_int,
    ) -> Result<Vec<u8>, SdkError> {
        let mut size = 0usize;
        let answer = ask(ptr::null_mut(), &mut size);
        if answer != TOO_SMALL && answer != OK {
            return Err(Sdk::failed(function));
        }
        if size > most {
            let detail = format!("found {size} bytes, expected at most {most}");
            return Err(SdkError::Impossible { function, detail });
        }
        let mut bytes = vec![0u8; size];
        let mut filled = size;
        if size > 0 && ask(bytes.as_mut_ptr(), &mut filled) != OK {
            return Err(Sdk::failed(function));
        }
        bytes.truncate(filled);
        Ok(bytes)
    }

    /// Starts streaming.
    pub(crate) fn start(&mut self, configuration: &Configuration) -> Result<(), SdkError> {
        let _before = log::take();
        // SAFETY: the device is open, the configuration lives through the call and has the library's layout.
        let answer = unsafe { (self.sdk.functions.start)(self.handle, configuration) };
        self.streams = answer == OK;
        if self.streams { Ok(()) } else { Err(Sdk::failed("k4a_device_start_cameras")) }
    }

    /// Stops streaming.
    pub(crate) fn stop(&mut self) {
        if std::mem::take(&mut self.streams) {
            // SAFETY: the device is open and streams; no capture call runs, since that needs `&mut self` too.
            unsafe { (self.sdk.functions.stop)(self.handle) }
        }
    }

    /// Waits for the next capture; `None` when none came in time, or one without depth.
    pub(crate) fn capture(&mut self, timeout: Duration) -> Result<Option<Depth>, SdkError> {
        let timeout_ms = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
        let mut handle = ptr::null_mut();
        // SAFETY: the device is open, `handle` lives through the call.
        let answer = unsafe { (self.sdk.functions.capture)(self.handle, &mut handle, timeout_ms) };
        match answer {
            OK if !handle.is_null() => Capture { sdk: self.sdk.clone(), handle }.depth(),
            TIMED_OUT => Ok(None),
            _ => Err(Sdk::failed("k4a_device_get_capture")),
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.stop();
        // SAFETY: the device is open and closed once.
        unsafe { (self.sdk.functions.close)(self.handle) }
    }
}

/// A capture: one reference, given back when dropped.
struct Capture {
    sdk: Arc<Sdk>,
    handle: Handle,
}

impl Capture {
    /// Its depth image, copied.
    fn depth(&self) -> Result<Option<Depth>, SdkError> {
        // SAFETY: the capture is alive; the image is one more reference, which its owner here gives back.
        let handle = unsafe { (self.sdk.functions.capture_depth)(self.handle) };
        if handle.is_null() {
            return Ok(None);
        }
        let image = Image { sdk: self.sdk.clone(), handle };
        // SAFETY: the capture is alive.
        let temperature_c = unsafe { (self.sdk.functions.capture_temperature)(self.handle) };
        image.copy(temperature_c).map(Some)
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        // SAFETY: this is the last use of this reference.
        unsafe { (self.sdk.functions.capture_release)(self.handle) }
    }
}

/// An image: one reference, given back when dropped.
struct Image {
    sdk: Arc<Sdk>,
    handle: Handle,
}

impl Image {
    fn copy(&self, temperature_c: f32) -> Result<Depth, SdkError> {
        let f = &self.sdk.functions;
        // SAFETY: the image is alive in all of these.
        let (format, width, height, stride, size, buffer, device_us) = unsafe {
            (
                (f.image_format)(self.handle),
                (f.image_width)(self.handle),
                (f.image_height)(self.handle),
                (f.image_stride)(self.handle),
                (f.image_size)(self.handle),
                (f.image_buffer)(self.handle),
                (f.image_device_us)(self.handle),
            )
        };
        let told = format!("format {format}, {width} x {height}, {stride} bytes a row, {size} bytes");
        let refuse = || SdkError::Impossible {
            function: "k4a_image_get_buffer",
            detail: format!("found {told}, expected a whole DEPTH16 image"),
        };
        let sides = (1..=MOST_PIXELS).contains(&width) && (1..=MOST_PIXELS).contains(&height);
        if format != DEPTH16 || !sides || stride < 2 * width || buffer.is_null() {
            return Err(refuse());
        }
        let (width, height, stride) = (width as usize, height as usize, stride as usize);
        if size < stride.saturating_mul(height) {
            return Err(refuse());
        }
        // SAFETY: the buffer has `size` bytes, at least `stride * height`; the library does not write to it while this
        // reference lives.
        let bytes = unsafe { std::slice::from_raw_parts(buffer, stride * height) };
        let mut mm = Vec::with_capacity(width * height);
        for row in bytes.chunks_exact(stride) {
            let (pairs, _) = row[..2 * width].as_chunks::<2>();
            mm.extend(pairs.iter().map(|pair| u16::from_ne_bytes(*pair)));
        }
        let stamp = Duration::from_micros(device_us);
        Ok(Depth { width, height, mm, stamp, temperature_c })
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        // SAFETY: this is the last use of this reference.
        unsafe { (self.sdk.functions.image_release)(self.handle) }
    }
}

//! Cameras that are reached over a cable, and recordings of them.

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use graspd_adapters_azure_kinect::{KinectCamera, KinectSettings};
use graspd_adapters_core::check::Finding;
use graspd_adapters_core::{DepthCamera, DeviceError};
use graspd_adapters_pico_flexx::{FlexxCamera, FlexxSettings};
use graspd_cell::config::CellConfig;

use super::sections;

/// Any kind of camera.
#[derive(Debug, Clone)]
pub(crate) enum AnyCamera {
    Kinect(Arc<KinectCamera>),
    Flexx(Arc<FlexxCamera>),
}

impl AnyCamera {
    /// As any camera.
    pub(crate) fn camera(&self) -> Arc<dyn DepthCamera> {
        match self {
            Self::Kinect(camera) => camera.clone(),
            Self::Flexx(camera) => camera.clone(),
        }
    }

    /// What is wrong with it and what to do about it; it begins to stream for that.
    pub(crate) async fn check(&self, timeout: Duration) -> Vec<Finding> {
        match self {
            Self::Kinect(camera) => camera.check(timeout).await,
            Self::Flexx(camera) => camera.check(timeout).await,
        }
    }

    /// One frame in words: size, share of pixels with depth, their median, age.
    ///
    /// # Errors
    /// As [`DepthCamera::capture`].
    pub(crate) async fn describe(&self, text: &mut String, timeout: Duration) -> Result<(), DeviceError> {
        let frame = self.camera().capture(timeout, timeout).await?;
        let mut depths: Vec<f32> = frame.depth_m.iter().copied().filter(|d| *d > 0.0).collect();
        depths.sort_by(f32::total_cmp);
        let median = depths.get(depths.len() / 2).map_or_else(|| "-".to_owned(), |d| format!("{d:.3} m"));
        let share = 100.0 * depths.len() as f64 / frame.depth_m.len().max(1) as f64;
        let _ = writeln!(
            text,
            "camera  {} x {}, {share:.0} % with depth, median {median}, {:.0} ms old",
            frame.width,
            frame.height,
            frame.age.as_secs_f64() * 1e3
        );
        Ok(())
    }
}

/// Settings of a camera.
#[derive(Debug, Clone)]
pub(crate) enum CameraSettings {
    Kinect(KinectSettings),
    Flexx(FlexxSettings),
}

/// Settings of the camera, as the cell's file says.
///
/// # Errors
/// For a kind, an address or a table that is not in order.
pub(crate) fn settings(config: &CellConfig) -> anyhow::Result<CameraSettings> {
    let [section, _, _] = sections(config);
    section.check()?;
    if section.kind == "azure-kinect" {
        let settings = section.settings::<KinectSettings>(&[])?.with_address(section.address);
        settings.check().context("camera.settings.azure-kinect")?;
        return Ok(CameraSettings::Kinect(settings));
    }
    let settings = section.settings::<FlexxSettings>(&[])?.with_address(section.address);
    settings.check().context("camera.settings.pico-flexx")?;
    Ok(CameraSettings::Flexx(settings))
}

/// Connects to the camera. A device that is not there is reached when a frame is asked for.
///
/// # Errors
/// For a kind or a table that is not in order, and for a recording that cannot be read.
pub(crate) async fn connect(config: &CellConfig) -> anyhow::Result<AnyCamera> {
    Ok(match settings(config)? {
        CameraSettings::Kinect(settings) => AnyCamera::Kinect(Arc::new(KinectCamera::new(settings).await?)),
        CameraSettings::Flexx(settings) => AnyCamera::Flexx(Arc::new(FlexxCamera::new(settings)?)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        let config = CellConfig::parse(text).unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        format!("{:#}", runtime.block_on(connect(&config)).unwrap_err())
    }

    #[test]
    fn cameras_that_cannot_be_are_refused_by_name() {
        for (text, expected) in [
            ("[camera]\nkind = \"azure-kinect\"\naddress = \"/nowhere/a.mkv\"", "/nowhere/a.mkv"),
            (
                "[camera]\nkind = \"azure-kinect\"\naddress = \"emulator\"",
                "camera.address: found \"emulator\"",
            ),
            (
                "[camera]\nkind = \"pico-flexx\"\n[camera.settings.pico-flexx]\nretry_ms = 0",
                "retry_ms: found 0, expected 10 to 60000",
            ),
            (
                "[camera]\nkind = \"pico-flexx\"\n[camera.settings.pico-flexx]\nspeed = 1",
                "camera.settings.pico-flexx: ",
            ),
            (
                "[camera]\nkind = \"webcam\"",
                "camera.kind: found \"webcam\", expected one of mock, azure-kinect",
            ),
        ] {
            let message = refused(text);
            assert!(message.contains(expected), "{message}\nshould contain\n{expected}");
        }
    }
}

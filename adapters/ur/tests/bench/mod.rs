//! An adapter and an emulated controller, connected by real sockets.
#![allow(dead_code)] // Each test file uses its part.

use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::Limits;
use graspd_adapters_emulators::ur::{Plant, UrEmulator, UrPorts, UrSettings};
use graspd_adapters_ur::{Dashboard, Ports, UrArm, UrConfig, Workspace};
use nalgebra::Isometry3;

pub(crate) const SOON: Duration = Duration::from_secs(5);
pub(crate) const LONG: Duration = Duration::from_secs(20);
pub(crate) const LIMITS: Limits = Limits { speed_m_s: 0.25, acceleration_m_s2: 1.0 };

pub(crate) fn settings() -> UrSettings {
    UrSettings { ports: UrPorts::FREE, unlock_wait_s: 0.6, mode_change_s: 0.05, ..UrSettings::default() }
}

/// Settings of an adapter for an emulator.
pub(crate) fn config(emulator: &UrEmulator) -> UrConfig {
    let addresses = emulator.addresses();
    let mut config = UrConfig {
        host: addresses.rtde.ip().to_string(),
        ports: Ports {
            rtde: addresses.rtde.port(),
            dashboard: addresses.dashboard.port(),
            primary: addresses.primary.port(),
        },
        armed: true,
        connect_timeout_s: 1.0,
        longest_pause_s: 0.5,
        ..UrConfig::default()
    };
    config.limits.workspace = Workspace { lower_m: [-1.0, -1.0, 0.05], upper_m: [1.0, 1.0, 1.2] };
    // Machines of tests pause for long; the time itself is tested where it matters.
    config.heartbeat.timeout_s = 0.5;
    config
}

pub(crate) struct Bench {
    pub(crate) emulator: UrEmulator,
    pub(crate) arm: Arc<UrArm>,
}

pub(crate) async fn bench() -> Bench {
    bench_with(settings(), None, |_| {}).await
}

pub(crate) async fn bench_with(
    settings: UrSettings,
    plant: Option<Box<dyn Plant>>,
    change: impl FnOnce(&mut UrConfig),
) -> Bench {
    let emulator = match plant {
        Some(plant) => UrEmulator::start_with(settings, plant).await.unwrap(),
        None => UrEmulator::start(settings).await.unwrap(),
    };
    let mut config = config(&emulator);
    change(&mut config);
    let arm = Arc::new(UrArm::new(config).unwrap());
    Bench { emulator, arm }
}

impl Bench {
    /// A dashboard of one's own: the arm lends out none.
    pub(crate) fn dashboard(&self) -> Dashboard {
        let config = self.arm.config();
        let limit = Duration::from_secs_f64(config.connect_timeout_s);
        Dashboard::new(config.host.clone(), config.ports.dashboard, limit)
    }

    pub(crate) fn flange(&self) -> Isometry3<f64> {
        self.emulator.snapshot().base_from_flange
    }

    /// The flange's pose, moved by so much.
    pub(crate) fn beside(&self, x: f64, y: f64, z: f64) -> Isometry3<f64> {
        let mut pose = self.flange();
        pose.translation.vector += nalgebra::Vector3::new(x, y, z);
        pose
    }

    pub(crate) fn moves(&self) -> bool {
        self.emulator.snapshot().joint_speeds.iter().any(|v| v.abs() > 0.01)
    }

    pub(crate) async fn until(&self, what: &str, condition: impl Fn(&Self) -> bool) {
        let until = tokio::time::Instant::now() + SOON;
        while !condition(self) {
            assert!(tokio::time::Instant::now() < until, "never: {what}: {:?}", self.emulator.snapshot());
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }
}

pub(crate) fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}

//! An emulated Universal Robots controller: dashboard, primary, secondary and real-time interfaces, RTDE.
//!
//! It runs the scripts that it is sent, in step with its 2 ms control loop, on a [`Plant`]: the built-in one follows
//! like joint servos, another one may be a simulated world. What it does not emulate is refused, never pretended.

mod controller;
mod dashboard;
mod fields;
mod geometry;
mod motion;
mod plant;
mod ports;
mod primary;
mod robot;
mod rtde;
mod script;
mod settings;

use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, watch};
use tokio::task::{AbortHandle, JoinSet};

pub use geometry::{Six, UrModel, from_six, to_six};
pub use plant::{JointServo, Plant, PlantState, PlantTarget, Wall};
pub use robot::Safety;
pub use script::ScriptError;
pub use settings::{UrPorts, UrSettings};

use self::controller::Controller;
use self::ports::Port;
use self::primary::Stream;
use self::robot::Robot;
use crate::faults::LinkFaults;

/// Where the emulator listens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UrAddresses {
    /// Dashboard.
    pub dashboard: SocketAddr,
    /// Primary interface.
    pub primary: SocketAddr,
    /// Secondary interface.
    pub secondary: SocketAddr,
    /// Real-time interface.
    pub realtime: SocketAddr,
    /// RTDE.
    pub rtde: SocketAddr,
}

/// Faults of each link.
#[derive(Debug, Clone, Default)]
pub struct UrFaults {
    /// Of the dashboard.
    pub dashboard: LinkFaults,
    /// Of the primary, secondary and real-time interfaces.
    pub scripts: LinkFaults,
    /// Of RTDE.
    pub rtde: LinkFaults,
}

/// What the emulated arm does, seen from outside its wires.
#[derive(Debug, Clone, PartialEq)]
pub struct UrSnapshot {
    /// Joint positions, radians.
    pub joints: Six,
    /// Joint speeds, radians per second.
    pub joint_speeds: Six,
    /// Joint speeds as commanded, radians per second.
    pub target_speeds: Six,
    /// Pose of the flange, base frame.
    pub base_from_flange: nalgebra::Isometry3<f64>,
    /// Mode of the robot as the controller numbers it.
    pub robot_mode: i32,
    /// State of the safety system.
    pub safety: Safety,
    /// True while a program runs.
    pub program_running: bool,
    /// Integer registers that clients write.
    pub input_ints: [i32; 48],
    /// Integer registers that scripts write.
    pub output_ints: [i32; 48],
    /// Digital outputs.
    pub digital_out: u64,
    /// Share of the speed.
    pub speed_slider: f64,
    /// Control steps since the start.
    pub steps: u64,
}

/// A running emulator. It ends when it is dropped.
#[derive(Debug)]
pub struct UrEmulator {
    robot: Held,
    addresses: UrAddresses,
    faults: UrFaults,
    tasks: Vec<AbortHandle>,
    connections: Arc<Mutex<usize>>,
}

#[derive(Clone)]
struct Held(Arc<Mutex<Robot>>);

impl std::fmt::Debug for Held {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("robot")
    }
}

impl UrEmulator {
    /// Listens, with the built-in plant.
    ///
    /// # Errors
    /// A port cannot be listened on.
    pub async fn start(settings: UrSettings) -> io::Result<Self> {
        let q = settings.joints.unwrap_or(plant::home(settings.model));
        Self::start_with(settings, Box::new(JointServo::new(q))).await
    }

    /// Listens, with a plant of one's own, which stands where the settings say (else folded, see
    /// [`UrSettings::joints`]).
    ///
    /// # Errors
    /// A port cannot be listened on.
    pub async fn start_with(settings: UrSettings, plant: Box<dyn Plant>) -> io::Result<Self> {
        let q = settings.joints.unwrap_or(plant::home(settings.model));
        let robot = Arc::new(Mutex::new(Robot::new(&settings, q, plant)));
        let settings = Arc::new(settings);
        let (steps, watched) = watch::channel(0);
        let (scripts, received) = mpsc::unbounded_channel();
        let faults = UrFaults::default();
        let port = |faults: &LinkFaults| Port {
            robot: robot.clone(),
            settings: settings.clone(),
            faults: faults.clone(),
            steps: watched.clone(),
            scripts: scripts.clone(),
        };
        let bind = |number: u16| TcpListener::bind((settings.address, number));
        let ports = settings.ports;
        let listeners = [
            bind(ports.dashboard).await?,
            bind(ports.primary).await?,
            bind(ports.secondary).await?,
            bind(ports.realtime).await?,
            bind(ports.rtde).await?,
        ];
        let addresses = UrAddresses {
            dashboard: listeners[0].local_addr()?,
            primary: listeners[1].local_addr()?,
            secondary: listeners[2].local_addr()?,
            realtime: listeners[3].local_addr()?,
            rtde: listeners[4].local_addr()?,
        };
        let connections = Arc::new(Mutex::new(0));
        let owners = rtde::Owners::default();
        let mut tasks = Vec::new();
        for (number, listener) in listeners.into_iter().enumerate() {
            let link = match number {
                0 => &faults.dashboard,
                4 => &faults.rtde,
                _ => &faults.scripts,
            };
            let (port, owners) = (port(link), owners.clone());
            let serve = move |port: Port, id: u64, stream: TcpStream| {
                let owners = owners.clone();
                async move {
                    match number {
                        0 => dashboard::serve(port, stream).await,
                        1 => primary::serve(port, Stream::Primary, stream).await,
                        2 => primary::serve(port, Stream::Secondary, stream).await,
                        3 => primary::serve(port, Stream::Realtime, stream).await,
                        _ => rtde::serve(port, owners, id, stream).await,
                    }
                }
            };
            tasks.push(tokio::spawn(listen(listener, port, connections.clone(), serve)).abort_handle());
        }
        let program = Controller {
            robot: robot.clone(),
            steps,
            scripts: received,
            program: None,
            secondary: Vec::new(),
        };
        tasks.push(tokio::spawn(program.run()).abort_handle());
        Ok(Self { robot: Held(robot), addresses, faults, tasks, connections })
    }

    fn robot(&self) -> MutexGuard<'_, Robot> {
        self.robot.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where it listens.
    pub fn addresses(&self) -> UrAddresses {
        self.addresses
    }

    /// What its links do wrong.
    pub fn faults(&self) -> &UrFaults {
        &self.faults
    }

    /// Connections that are open now, on all ports.
    pub fn connections(&self) -> usize {
        *self.connections.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the arm does now.
    pub fn snapshot(&self) -> UrSnapshot {
        let robot = self.robot();
        UrSnapshot {
            joints: robot.state.q,
            joint_speeds: robot.state.qd,
            target_speeds: robot.mover.qd,
            base_from_flange: robot.actual_flange(),
            robot_mode: robot.mode,
            safety: robot.safety(),
            program_running: robot.runtime == 2,
            input_ints: robot.inputs.ints,
            output_ints: robot.outputs.ints,
            digital_out: robot.digital_out,
            speed_slider: robot.slider,
            steps: robot.steps,
        }
    }

    /// The arm stops itself, as it does when it meets something hard.
    pub fn protective_stop(&self, why: &str) {
        self.robot().set_safety(Safety::ProtectiveStop, why);
    }

    /// Presses or releases the emergency button. Released, the arm stays without power.
    pub fn emergency_stop(&self, pressed: bool) {
        let safety = if pressed { Safety::EmergencyStop } else { Safety::Normal };
        self.robot().set_safety(safety, "emergency button");
    }

    /// Opens or closes the safeguard input.
    pub fn safeguard(&self, open: bool) {
        let safety = if open { Safety::SafeguardStop } else { Safety::Normal };
        self.robot().set_safety(safety, "safeguard input");
    }

    /// Violates a safety limit.
    pub fn violation(&self) {
        self.robot().set_safety(Safety::Violation, "safety limit");
    }

    /// Hands control to the network, or back to the pendant.
    pub fn set_remote_control(&self, remote: bool) {
        self.robot().remote = remote;
    }

    /// Takes an input field away from clients, as a fieldbus does; or gives it back.
    pub fn occupy(&self, field: &str, occupied: bool) {
        let mut robot = self.robot();
        if occupied {
            robot.occupied.insert(field.to_owned());
        } else {
            robot.occupied.remove(field);
        }
    }

    /// Ends the program that runs, as the stop button of the pendant does.
    pub fn stop_program(&self) {
        self.robot().stop_program = true;
    }
}

impl Drop for UrEmulator {
    fn drop(&mut self) {
        self.tasks.iter().for_each(AbortHandle::abort);
    }
}

/// Takes connections until it is aborted; they end with it.
async fn listen<S, F>(listener: TcpListener, port: Port, open: Arc<Mutex<usize>>, serve: S)
where
    S: Fn(Port, u64, TcpStream) -> F,
    F: Future<Output = io::Result<()>> + Send + 'static,
{
    let mut connections = JoinSet::new();
    let mut next = 0;
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = connections.join_next() => continue,
        };
        let Ok((stream, peer)) = accepted else {
            tokio::time::sleep(std::time::Duration::from_millis(10)).await;
            continue;
        };
        if port.faults.current().refuse || stream.set_nodelay(true).is_err() {
            continue;
        }
        next += 1;
        let cut = port.faults.until_cut();
        let serving = serve(port.clone(), next, stream);
        let counted = Counted::new(open.clone());
        connections.spawn(async move {
            let _counted = counted;
            tokio::select! {
                ended = serving => if let Err(error) = ended {
                    tracing::debug!(%peer, %error, "emulated connection ended");
                },
                () = cut => tracing::debug!(%peer, "emulated connection cut"),
            }
        });
    }
}

/// Counts open connections.
struct Counted(Arc<Mutex<usize>>);

impl Counted {
    fn new(count: Arc<Mutex<usize>>) -> Self {
        *count.lock().unwrap_or_else(PoisonError::into_inner) += 1;
        Self(count)
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) -= 1;
    }
}

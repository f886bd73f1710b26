//! Devices, a planner and a watcher that share one small world and fail when they are told to.

use std::collections::BTreeMap;
use std::future::pending;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use graspd_adapters_core::follow::{Goal, Goals};
use graspd_adapters_core::{
    Arm, ArmInfo, ArmMode, ArmState, CameraInfo, DepthCamera, DepthFrame, DeviceError, FaultKind,
    GripCommand, Hand, HandInfo, HandState, Leg, Lens, Limits, Reach, Reached, async_trait,
};
use graspd_cell::Cell;
use graspd_cell::config::CellConfig;
use graspd_cell::frame::Frame;
use graspd_cell::observer::{Event, Observer};
use graspd_cell::plan::{
    ActuatorFacts, Answer, EmptyReason, GraspPlanner, GraspServo, HandFacts, NoGrasp, PlannedGrasp,
    PlannerError, Question, ServoAnswer, ServoFrame, ServoQuestion, ServoState,
};
use graspd_cell::pose::{PoseRecord, pointing_down};
use graspd_cell::steps::Step;
use nalgebra::{Isometry3, Unit, Vector3};

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(dead_code)]
pub(crate) enum Fault {
    /// A documented time-out.
    Timeout,
    /// Never an answer: the device breaks its word.
    Hangs,
    /// The link is down.
    Disconnected,
    /// The device stops itself.
    Stop,
    /// A person pressed the button.
    Emergency,
    /// Cannot be done.
    OutOfRange,
    /// Broken for good.
    Broken,
    /// The object slips out of the hand.
    Slips,
    /// The hand feels nothing of what it holds.
    Numb,
    /// The hand meets something on its way, after [`World::met_after`] of it.
    Contact,
    /// The planner is away.
    PlannerAway,
    /// The planner fails.
    PlannerFails,
    /// The planner has no grasp.
    NoGrasp,
    /// The servo has nothing to follow.
    TargetLost,
    /// The servo's stream breaks.
    StreamBreaks,
    /// The servo does not answer.
    StreamSilent,
}

/// The world that all share.
#[derive(Debug)]
pub(crate) struct World {
    pub(crate) in_tray: u32,
    pub(crate) in_hand: u32,
    pub(crate) delivered: u32,
    pub(crate) lost: u32,
    pub(crate) total: u32,
    pub(crate) flange: Isometry3<f64>,
    pub(crate) arm_stopped: bool,
    pub(crate) exposure: u64,
    pub(crate) step: Step,
    /// Where, which, how many times more.
    pub(crate) faults: Vec<(Step, Fault, u32)>,
    /// Calls of each name.
    pub(crate) calls: BTreeMap<&'static str, u32>,
    pub(crate) questions: Vec<Question>,
    pub(crate) closed: bool,
    pub(crate) end_wanted: bool,
    /// Highest flange that the arm reaches, metres.
    pub(crate) reach_z_m: f64,
    /// Steps in which the way straight up is out of reach.
    pub(crate) no_way_up: Vec<Step>,
    /// The arm says before it goes that it does not get so far along x, metres; `None`: it cannot tell.
    pub(crate) reach_x_m: Option<f64>,
    /// Share of the way after which the hand meets something, with [`Fault::Contact`].
    pub(crate) met_after: f64,
    /// Where the planned grasps open the thumb; the finger opens twice as far.
    pub(crate) open: f64,
    /// So many objects that are let go at the drop pose fall beside it.
    pub(crate) misses: u32,
    /// On the way out of a failed attempt open fingers press so hard on what is around them that the arm stops itself, also
    /// when it has been released.
    pub(crate) wedges: bool,
    /// Where the arm went, and in which step.
    pub(crate) moves: Vec<(Step, Isometry3<f64>)>,
    /// Where the thumb was told to go, and in which step.
    pub(crate) thumb: Vec<(Step, f64)>,
    /// The camera sits in the palm.
    pub(crate) palm_camera: bool,
    /// Servo streams that were begun.
    pub(crate) streams: u32,
}

impl World {
    fn is_wedged(&self) -> bool {
        let opened = self.thumb.last().is_some_and(|(step, at)| *step == Step::Retreat && *at < 0.5);
        self.wedges && opened && self.flange.translation.vector.z < 0.2
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Shared(pub(crate) Arc<Mutex<World>>);

impl Shared {
    pub(crate) fn new(objects: u32) -> Self {
        Self(Arc::new(Mutex::new(World {
            in_tray: objects,
            in_hand: 0,
            delivered: 0,
            lost: 0,
            total: objects,
            flange: Isometry3::translation(0.3, 0.3, 0.5),
            arm_stopped: false,
            exposure: 0,
            step: Step::ClearView,
            faults: Vec::new(),
            calls: BTreeMap::new(),
            questions: Vec::new(),
            closed: false,
            end_wanted: false,
            reach_z_m: f64::INFINITY,
            no_way_up: Vec::new(),
            reach_x_m: None,
            met_after: 0.5,
            open: 0.0,
            misses: 0,
            wedges: false,
            moves: Vec::new(),
            thumb: Vec::new(),
            palm_camera: false,
            streams: 0,
        })))
    }

    pub(crate) fn world(&self) -> MutexGuard<'_, World> {
        let world = self.0.lock().unwrap();
        assert_eq!(
            world.in_tray + world.in_hand + world.delivered + world.lost,
            world.total,
            "an object is lost from the count: {world:?}"
        );
        world
    }

    pub(crate) fn with_fault(self, step: Step, fault: Fault, times: u32) -> Self {
        self.world().faults.push((step, fault, times));
        self
    }

    pub(crate) fn cell(&self) -> Cell {
        Cell {
            camera: Arc::new(self.clone()),
            arm: Arc::new(self.clone()),
            hand: Arc::new(self.clone()),
            planner: Arc::new(self.clone()),
            witness: None,
        }
    }

    /// The fault that is due for a call of this kind, if any.
    fn due(&self, name: &'static str, fits: &[Fault]) -> Option<Fault> {
        let mut world = self.world();
        *world.calls.entry(name).or_default() += 1;
        let step = world.step;
        let due = world.faults.iter_mut().find(|(s, f, n)| *s == step && *n > 0 && fits.contains(f))?;
        due.2 -= 1;
        Some(due.1)
    }

    async fn device(&self, device: &str, name: &'static str, fits: &[Fault]) -> Result<(), DeviceError> {
        tokio::time::sleep(Duration::from_millis(50)).await;
        let Some(fault) = self.due(name, fits) else { return Ok(()) };
        let device = device.to_owned();
        let stop = |kind| DeviceError::Fault { device: device.clone(), kind, detail: "scripted".into() };
        Err(match fault {
            Fault::Timeout => DeviceError::Timeout { device, operation: name, after: Duration::from_secs(1) },
            Fault::Hangs => pending().await,
            Fault::Disconnected => DeviceError::Disconnected { device, detail: "scripted".into() },
            Fault::Stop => stop(FaultKind::ProtectiveStop),
            Fault::Emergency => stop(FaultKind::EmergencyStop),
            Fault::Broken => DeviceError::Protocol { device, detail: "scripted".into() },
            Fault::OutOfRange => DeviceError::OutOfRange {
                device,
                field: "pose".into(),
                found: "far".into(),
                expected: "near".into(),
            },
            Fault::Slips => {
                self.slip();
                return Ok(());
            }
            Fault::Numb
            | Fault::Contact
            | Fault::PlannerAway
            | Fault::PlannerFails
            | Fault::NoGrasp
            | Fault::TargetLost
            | Fault::StreamBreaks
            | Fault::StreamSilent => unreachable!("no fault of a call"),
        })
    }

    fn slip(&self) {
        let mut world = self.world();
        let over_tray = world.flange.translation.vector.x.abs() < 0.2;
        let slipped = std::mem::take(&mut world.in_hand);
        if over_tray {
            world.in_tray += slipped;
        } else {
            world.lost += slipped;
        }
    }
}

const DEVICE_FAULTS: &[Fault] = &[
    Fault::OutOfRange,
    Fault::Timeout,
    Fault::Hangs,
    Fault::Disconnected,
    Fault::Emergency,
    Fault::Broken,
    Fault::Stop,
];
const QUERY_FAULTS: &[Fault] = &[Fault::Timeout, Fault::Hangs, Fault::Disconnected, Fault::Slips];
const CAMERA_FAULTS: &[Fault] = &[Fault::Timeout, Fault::Hangs, Fault::Disconnected, Fault::Broken];

#[async_trait]
impl DepthCamera for Shared {
    fn info(&self) -> CameraInfo {
        CameraInfo {
            name: "camera".into(),
            model: "scripted".into(),
            width: 4,
            height: 3,
            frame_rate_hz: 30.0,
            range_m: (0.1, 3.0),
        }
    }

    async fn capture(&self, _max_age: Duration, _timeout: Duration) -> Result<DepthFrame, DeviceError> {
        self.device("camera", "capture", CAMERA_FAULTS).await?;
        let mut world = self.world();
        world.exposure += 1;
        // A camera in the palm goes where the hand goes.
        let away = world.palm_camera || world.flange.translation.vector.x > 0.25;
        assert!(away, "the arm is in the camera's view");
        Ok(DepthFrame {
            width: 4,
            height: 3,
            depth_m: Arc::from(vec![0.5 + 0.01 * world.in_tray as f32; 12]),
            lens: Lens { fx_px: 5.0, fy_px: 5.0, cx_px: 1.5, cy_px: 1.0, distortion: [0.0; 8] },
            world_from_camera: None,
            sequence: world.exposure,
            stamp: if world.palm_camera {
                Duration::from_millis(50 * world.exposure)
            } else {
                Duration::ZERO
            },
            age: Duration::from_millis(20),
        })
    }
}

impl Shared {
    async fn go(
        &self,
        name: &'static str,
        to: &Isometry3<f64>,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let stopped = |kind| DeviceError::Fault { device: "arm".into(), kind, detail: "stopped".into() };
        let (from, distance) = {
            let mut world = self.world();
            world.arm_stopped |= world.is_wedged();
            if world.arm_stopped {
                return Err(stopped(FaultKind::ProtectiveStop));
            }
            let between = to.translation.vector - world.flange.translation.vector;
            let sideways = (between.x.powi(2) + between.y.powi(2)).sqrt();
            let up = name == "move_linear" && sideways < 1e-6 && between.z > 0.0;
            if to.translation.vector.z > world.reach_z_m || (up && world.no_way_up.contains(&world.step)) {
                return Err(DeviceError::OutOfRange {
                    device: "arm".into(),
                    field: "z".into(),
                    found: "high".into(),
                    expected: "low".into(),
                });
            }
            // What a servo has led somewhere goes straight in from there.
            let led = world.palm_camera && matches!(world.step, Step::Follow | Step::Approach);
            let low = world.flange.translation.vector.z < 0.2 && sideways > 1e-6 && !led;
            assert!(!low, "sideways among the objects: {:?} to {to:?}", world.flange);
            (world.flange, between.norm())
        };
        // With an empty hand, a way straight up that is out of reach is left out in silence: the pose above the grasp
        // decides.
        let rises = name == "move_linear" && self.world().step == Step::Pregrasp;
        let fits = if rises { &DEVICE_FAULTS[1..] } else { DEVICE_FAULTS };
        let result = self.device("arm", name, fits).await;
        if let Err(error) = &result {
            let mut world = self.world();
            if matches!(error, DeviceError::Fault { .. }) {
                world.arm_stopped = true;
                world.flange = from.lerp_slerp(to, 0.5);
            }
            return result;
        }
        let takes = Duration::from_secs_f64(distance / limits.speed_m_s);
        assert!(takes < timeout, "a motion of {distance} m in {timeout:?}");
        tokio::time::sleep(takes).await;
        {
            let mut world = self.world();
            world.flange = *to;
            let step = world.step;
            world.moves.push((step, *to));
        }
        if self.due("slip", &[Fault::Slips]).is_some() {
            self.slip();
        }
        Ok(())
    }
}

#[async_trait]
impl Arm for Shared {
    fn info(&self) -> ArmInfo {
        ArmInfo { name: "arm".into(), model: "scripted".into(), reach_m: 1.0, replaces_motion: false }
    }

    fn reaches(&self, way: &[Leg]) -> Reach {
        let Some(reach_m) = self.world().reach_x_m else { return Reach::Unknown };
        assert_eq!(way.iter().map(|leg| leg.straight).collect::<Vec<_>>(), [false, true, true]);
        let beyond = |leg: &Leg| leg.world_from_flange.translation.vector.x > reach_m;
        match way.iter().rposition(beyond) {
            Some(leg) => Reach::Beyond { leg, why: "arm: x: found far, expected near".into() },
            None => Reach::Reaches,
        }
    }

    async fn state(&self, _timeout: Duration) -> Result<ArmState, DeviceError> {
        let world = self.world();
        let mode =
            if world.arm_stopped { ArmMode::Stopped(FaultKind::ProtectiveStop) } else { ArmMode::Ready };
        Ok(ArmState { mode, world_from_flange: world.flange, joints: Vec::new() })
    }

    async fn move_to(&self, to: &Isometry3<f64>, l: Limits, timeout: Duration) -> Result<(), DeviceError> {
        self.go("move_to", to, l, timeout).await
    }

    async fn move_linear(&self, to: &Isometry3<f64>, l: Limits, t: Duration) -> Result<(), DeviceError> {
        self.go("move_linear", to, l, t).await
    }

    async fn move_until_contact(
        &self,
        to: &Isometry3<f64>,
        limits: Limits,
        _force_n: f64,
        timeout: Duration,
    ) -> Result<Reached, DeviceError> {
        if self.due("met", &[Fault::Contact]).is_none() {
            return self.go("move_linear", to, limits, timeout).await.map(|()| Reached::Goal);
        }
        let short = {
            let world = self.world();
            world.flange.lerp_slerp(to, world.met_after)
        };
        self.go("move_linear", &short, limits, timeout).await.map(|()| Reached::Contact)
    }

    /// Jumps to each pose as it comes.
    async fn follow(
        &self,
        mut goals: Goals,
        _limits: Limits,
        silence: Duration,
        _timeout: Duration,
    ) -> Result<(), DeviceError> {
        loop {
            match goals.next(silence).await {
                Goal::Pose(to) => {
                    if let Some(fault) = self.due("follow", &[Fault::Stop, Fault::OutOfRange, Fault::Timeout])
                    {
                        let device = "arm".to_owned();
                        return Err(match fault {
                            Fault::Stop => {
                                self.world().arm_stopped = true;
                                let kind = FaultKind::ProtectiveStop;
                                DeviceError::Fault { device, kind, detail: "scripted".into() }
                            }
                            Fault::OutOfRange => {
                                let (field, found, expected) = ("pose".into(), "far".into(), "near".into());
                                DeviceError::OutOfRange { device, field, found, expected }
                            }
                            _ => DeviceError::Timeout { device, operation: "follow", after: silence },
                        });
                    }
                    let mut world = self.world();
                    let step = world.step;
                    if world.flange != to {
                        world.flange = to;
                        world.moves.push((step, to));
                    }
                }
                Goal::Silence => {
                    return Err(DeviceError::Timeout {
                        device: "arm".into(),
                        operation: "follow",
                        after: silence,
                    });
                }
                Goal::End => return Ok(()),
            }
        }
    }

    async fn stop(&self, _timeout: Duration) -> Result<(), DeviceError> {
        *self.world().calls.entry("stop").or_default() += 1;
        Ok(())
    }

    async fn clear_fault(&self, _timeout: Duration) -> Result<(), DeviceError> {
        *self.world().calls.entry("clear_arm").or_default() += 1;
        let mut world = self.world();
        world.arm_stopped = world.is_wedged();
        if world.arm_stopped {
            let (device, kind) = ("arm".into(), FaultKind::ProtectiveStop);
            return Err(DeviceError::Fault { device, kind, detail: "stopped again".into() });
        }
        Ok(())
    }
}

#[async_trait]
impl Hand for Shared {
    fn info(&self) -> HandInfo {
        HandInfo {
            name: "hand".into(),
            hand_id: "scripted".into(),
            actuators: vec!["thumb".into(), "finger".into()],
            feels_contact: true,
        }
    }

    async fn state(&self, _timeout: Duration) -> Result<HandState, DeviceError> {
        self.device("hand", "hand_state", QUERY_FAULTS).await?;
        let numb = self.due("numb", &[Fault::Numb]).is_some();
        let world = self.world();
        let held = world.in_hand > 0 && !numb;
        let at = if !world.closed {
            0.0
        } else if held {
            0.6
        } else {
            1.0
        };
        Ok(HandState { actuators: vec![at, 2.0 * at], held: vec![held, held], settled: true })
    }

    async fn grip(&self, command: &GripCommand, _timeout: Duration) -> Result<HandState, DeviceError> {
        self.device("hand", "grip", DEVICE_FAULTS).await?;
        // The order of this device, not that of the planner.
        assert_eq!(command.actuators[1], 2.0 * command.actuators[0]);
        {
            let mut world = self.world();
            let at = world.flange.translation.vector;
            world.closed = command.actuators[0] > 0.5;
            let step = world.step;
            world.thumb.push((step, command.actuators[0]));
            // Closing takes several grips; fingers that hold one object take no second.
            if world.closed && world.in_hand == 0 && world.in_tray > 0 && at.z < 0.16 {
                world.in_tray -= 1;
                world.in_hand += 1;
            } else if !world.closed && world.in_hand > 0 {
                let let_go = std::mem::take(&mut world.in_hand);
                if (at.x - 0.40).abs() < 0.01 && world.misses > 0 {
                    world.misses -= 1;
                    world.lost += let_go;
                } else if (at.x - 0.40).abs() < 0.01 {
                    world.delivered += let_go;
                } else if at.x.abs() < 0.2 {
                    world.in_tray += let_go;
                } else {
                    world.lost += let_go;
                }
            }
        }
        Hand::state(self, Duration::from_secs(1)).await
    }

    async fn clear_fault(&self, _timeout: Duration) -> Result<(), DeviceError> {
        *self.world().calls.entry("clear_hand").or_default() += 1;
        Ok(())
    }
}

fn grasp(x: f64, score: f64, open: f64) -> PlannedGrasp {
    let at = |z| {
        pointing_down(
            &Vector3::z_axis(),
            &Vector3::x(),
            &Vector3::new(0.0, 0.0, 0.1),
            &Vector3::new(x, 0.0, z),
            0.0,
        )
    };
    PlannedGrasp {
        world_from_pregrasp: PoseRecord::from(&at(0.15)),
        world_from_hand: PoseRecord::from(&at(0.05)),
        actuators: vec!["finger".into(), "thumb".into()],
        open: vec![2.0 * open, open],
        contact: vec![1.2, 0.6],
        squeezed: vec![2.0, 1.0],
        centroid_m: [x, 0.0, 0.04],
        score,
        epsilon: 0.1,
        clearance_m: 0.01,
    }
}

#[async_trait]
impl GraspPlanner for Shared {
    async fn hand(&self, id: &str, _timeout: Duration) -> Result<HandFacts, PlannerError> {
        Ok(HandFacts {
            id: id.to_owned(),
            revision: "r1".into(),
            approach: Unit::new_unchecked(Vector3::z()),
            lateral: Vector3::x(),
            tool_point: Vector3::new(0.0, 0.0, 0.1),
            actuators: [("finger", 2.0), ("thumb", 1.0)]
                .map(|(name, closed)| ActuatorFacts {
                    name: name.into(),
                    open: 0.0,
                    closed,
                    limits: [0.0, closed],
                })
                .into(),
            fingers: 2,
        })
    }

    async fn plan(&self, _: &Frame, question: &Question, _: Duration) -> Result<Answer, PlannerError> {
        tokio::time::sleep(Duration::from_millis(200)).await;
        let due = self.due("plan", &[Fault::PlannerAway, Fault::PlannerFails, Fault::NoGrasp, Fault::Hangs]);
        let none = |reason| Some(NoGrasp { reason, nearest_fix: "scripted".into() });
        let (grasps, no_grasp) = match due {
            Some(Fault::PlannerAway) => return Err(PlannerError::Away("scripted".into())),
            Some(Fault::PlannerFails) => return Err(PlannerError::Failed("scripted".into())),
            Some(Fault::Hangs) => pending().await,
            Some(_) => (Vec::new(), none(EmptyReason::AllRejected)),
            None if self.world().in_tray == 0 => (Vec::new(), none(EmptyReason::EmptyTable)),
            None => {
                let open = self.world().open;
                (vec![grasp(0.0, 0.9, open), grasp(0.05, 0.8, open), grasp(-0.05, 0.7, open)], None)
            }
        };
        self.world().questions.push(question.clone());
        let rejected = BTreeMap::from([("collision_table".to_owned(), 31), ("no_contact".to_owned(), 9)]);
        let hand_revision = "r1".to_owned();
        Ok(Answer { grasps, no_grasp, rejected, plan_s: 0.2, hand_revision, estimator: "scripted".into() })
    }

    async fn servo(&self, asked: &ServoQuestion, _: Duration) -> Result<Box<dyn GraspServo>, PlannerError> {
        let mut world = self.world();
        world.streams += 1;
        world.questions.push(asked.question.clone());
        Ok(Box::new(ScriptedServo { shared: self.clone(), newest: None, answers: 0 }))
    }
}

/// A servo that comes nearer with every frame: six answers, and then the hand may go in.
#[derive(Debug)]
struct ScriptedServo {
    shared: Shared,
    newest: Option<u64>,
    answers: u64,
}

#[async_trait]
impl GraspServo for ScriptedServo {
    async fn send(&mut self, frame: ServoFrame<'_>) -> Result<(), PlannerError> {
        self.newest = Some(frame.sequence);
        Ok(())
    }

    async fn next(&mut self) -> Result<ServoAnswer, PlannerError> {
        if self.newest.is_none() {
            return pending().await;
        }
        tokio::time::sleep(Duration::from_millis(30)).await;
        let Some(sequence) = self.newest.take() else { return pending().await };
        let due = self.shared.due(
            "servo",
            &[
                Fault::PlannerAway,
                Fault::TargetLost,
                Fault::StreamBreaks,
                Fault::StreamSilent,
                Fault::NoGrasp,
            ],
        );
        let (empty, open) = {
            let world = self.shared.world();
            (world.in_tray == 0, world.open)
        };
        let (state, reason) = match due {
            Some(Fault::StreamSilent) => pending().await,
            Some(Fault::TargetLost) => (ServoState::Lost, "target_gone"),
            Some(Fault::NoGrasp) => (ServoState::Lost, "all_rejected"),
            Some(_) => return Err(PlannerError::Away("scripted".into())),
            None if empty => (ServoState::Lost, "empty_table"),
            None if self.answers == 0 => (ServoState::Replanning, "first"),
            None => (ServoState::Tracking, ""),
        };
        let is_lost = state == ServoState::Lost;
        self.answers += u64::from(!is_lost);
        let near = (0.02 * self.answers.saturating_sub(1) as f64).min(0.1);
        // Refined: each answer is a millimetre further.
        let grasp = grasp(0.001 * self.answers as f64, 0.9, open);
        let standoff = {
            let (far, at) = (grasp.world_from_pregrasp.isometry(), grasp.world_from_hand.isometry());
            PoseRecord::from(&far.lerp_slerp(&at, near / 0.15))
        };
        let has_grasp = self.answers > 0;
        Ok(ServoAnswer {
            sequence,
            age: Duration::from_millis(30),
            state,
            reason: reason.to_owned(),
            grasp: has_grasp.then_some(grasp),
            open_joints: Vec::new(),
            world_from_standoff: has_grasp.then_some(standoff),
            standoff_m: 0.15 - near,
            go: self.answers > 6 && !is_lost,
            replanned: 1,
            unanswered: 0,
            refused: String::new(),
        })
    }
}

/// Tells the world which step runs.
#[derive(Debug)]
pub(crate) struct Watcher {
    pub(crate) shared: Shared,
    pub(crate) log: Vec<String>,
}

impl Observer for Watcher {
    fn on(&mut self, event: &Event<'_>) {
        match event {
            Event::StepBegan { step, .. } => self.shared.world().step = *step,
            Event::Trouble { step, trouble, recovery, .. } => {
                self.log.push(format!("{step} {} {recovery:?}", trouble.name()));
            }
            _ => {}
        }
    }

    fn wants_end(&self) -> bool {
        self.shared.world().end_wanted
    }
}

/// The configuration of the tests: the defaults, with little patience.
pub(crate) fn config() -> CellConfig {
    let mut config = CellConfig::default();
    config.run.time_limit_s = 2000.0;
    config
}

/// Runs to the end, which must come: a limit that only a hang can reach.
pub(crate) async fn run(shared: &Shared, config: &CellConfig) -> (graspd_cell::report::Report, Vec<String>) {
    let mut watcher = Watcher { shared: shared.clone(), log: Vec::new() };
    let cell = shared.cell();
    let clearing = graspd_cell::clear_tray(&cell, config, &mut watcher);
    let report =
        tokio::time::timeout(Duration::from_secs(100_000), clearing).await.expect("it hangs").unwrap();
    let t = &report.tally;
    let failures: u32 = t.failures.values().sum();
    assert_eq!(t.attempts, t.successes + failures + t.not_executed + t.unknown, "{report:?}");
    (report, watcher.log)
}

//! The loop of a sorting run: look, assign, dispatch, hear.

mod finish;
mod give;
mod hear;
mod look;
mod parts;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use graspd_assign::Swept;
use nalgebra::Isometry3;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::config::SortConfig;
use super::objects::Seen;
use super::offer::{Look, Station};
use super::record::SortRecorder;
use super::report::SortReport;
use super::shares::Shares;
use super::space::Space;
use super::table::{Doing, SortObserver};
use super::worker::{Notice, Order, Worker};
use crate::observer::Silent;
use crate::outcome::End;
use crate::run::{Cell, CellError, facts, seconds};

pub use parts::{ArmCell, Recognizer, SortCell, SortError};

/// An arm as the loop knows it.
#[derive(Debug)]
struct ArmState {
    doing: Doing,
    orders: mpsc::UnboundedSender<Order>,
    trials: u32,
    delivered: u32,
    /// When it was lost.
    lost_at: Option<Instant>,
    lost: u32,
    came_back: u32,
    tries: u32,
    report: Option<crate::report::Report>,
    /// The grasp that it takes.
    target: Option<Isometry3<f64>>,
    /// The space that it takes from where it has lifted on.
    tail: Option<Arc<Swept>>,
    /// True while it may be between the camera and the tray.
    is_over_tray: bool,
    /// What it is taking, as it lay there: until it has lifted it, nobody else takes that or what lies against it.
    taking: Option<Seen>,
    /// How far what it carries may reach from its tool point, metres; 0: it carries nothing.
    carries_m: f64,
    /// Idle because others are in the way.
    blocked: bool,
    /// Where its time went.
    time: Shares,
}

impl ArmState {
    /// True when it is at home, or comes there next without being over the tray any more.
    fn is_coming(&self) -> bool {
        match self.doing {
            Doing::Idle { .. } => true,
            Doing::Homing | Doing::Picking { .. } => !self.is_over_tray,
            Doing::Lost { .. } | Doing::Out { .. } => false,
        }
    }
}

/// Sorts a tray: every object that a rule fits goes into a bin of that rule, by whichever arm it is given to.
///
/// It ends: calls are bounded as in a run with one arm, looks without a pick are bounded, and no pick begins after the time
/// limit. An arm that fails leaves the others their work: its object goes back, its space stays closed until it is
/// known to have left it.
///
/// # Errors
/// [`SortError`] before anything has moved. After that every end is a [`SortReport`].
pub async fn sort(
    cell: &SortCell,
    config: &SortConfig,
    observer: &mut dyn SortObserver,
) -> Result<SortReport, SortError> {
    config.check()?;
    let mut stations = Vec::with_capacity(config.arms.len());
    for (arm, parts) in config.arms.iter().zip(&cell.arms) {
        let facts = facts(&*cell.planner, &config.cell(arm), &mut Silent).await?;
        let station = Station::new(config, arm, parts, facts);
        if station.hand.bodies.is_empty() {
            return Err(SortError::Hand { arm: arm.name.clone() });
        }
        stations.push(station);
    }
    let mut grounds = Vec::with_capacity(stations.len());
    for ((station, arm), parts) in stations.iter().zip(&config.arms).zip(&cell.arms) {
        let ground = station.ground(parts, config, arm);
        grounds.push(ground.map_err(|why| SortError::Home { arm: arm.name.clone(), why })?);
    }
    let name = |i: usize| config.arms[i].name.clone();
    let space = Space::new(grounds, config.sort.clearance_m, seconds(config.sort.lease_s));
    let space = space.map_err(|(a, b)| SortError::Ground { first: name(a), second: name(b) })?;
    let recorder = config.recording.folder.as_ref().map(|f| SortRecorder::create(f, config)).transpose()?;
    let (tell, notices) = mpsc::unbounded_channel();
    let stop = Arc::new(AtomicBool::new(false));
    let mut workers = JoinSet::new();
    let mut arms = Vec::new();
    for (i, (parts, station)) in cell.arms.iter().zip(&stations).enumerate() {
        let (orders, hears) = mpsc::unbounded_channel();
        let worker = Worker {
            arm: i,
            cell: Cell {
                camera: cell.camera.clone(),
                arm: parts.arm.clone(),
                hand: parts.hand.clone(),
                planner: cell.planner.clone(),
                witness: None,
            },
            config: config.cell(&config.arms[i]),
            facts: station.facts.clone(),
            orders: hears,
            tell: tell.clone(),
            stop: stop.clone(),
        };
        workers.spawn(async move { (i, worker.work().await) });
        arms.push(ArmState {
            doing: Doing::Homing,
            orders,
            trials: 0,
            delivered: 0,
            lost_at: None,
            lost: 0,
            came_back: 0,
            tries: 0,
            report: None,
            target: None,
            tail: None,
            // Where it stands when the run begins nobody knows.
            is_over_tray: true,
            taking: None,
            carries_m: 0.0,
            blocked: false,
            time: Shares::default(),
        });
    }
    let lead = Lead {
        cell,
        config,
        observer,
        names: config.arms.iter().map(|a| a.name.clone()).collect(),
        stations,
        space,
        arms,
        notices,
        workers,
        stop,
        recorder,
        record_trouble: None,
        began: Instant::now(),
        look: None,
        looks: 0,
        idle_looks: 0,
        empty_looks: 0,
        failures: 0,
        last_exposure: None,
        failed: vec![Vec::new(); config.arms.len()],
        assignments: 0,
        together: 0,
        plan_s: Vec::new(),
        assign_s: Vec::new(),
        changed: true,
        is_stale: true,
        looks_past_arms: 0,
        over_tray_s: vec![0.0; config.arms.len() + 1],
        counted_s: cell.clock.now_s(),
        began_s: cell.clock.now_s(),
    };
    lead.run().await
}

struct Lead<'a> {
    cell: &'a SortCell,
    config: &'a SortConfig,
    observer: &'a mut dyn SortObserver,
    names: Vec<String>,
    stations: Vec<Station>,
    space: Space,
    arms: Vec<ArmState>,
    notices: mpsc::UnboundedReceiver<(usize, Notice)>,
    workers: JoinSet<(usize, Result<(), CellError>)>,
    stop: Arc<AtomicBool>,
    recorder: Option<SortRecorder>,
    record_trouble: Option<String>,
    began: Instant,
    /// The same on the cell's clock, seconds.
    began_s: f64,
    look: Option<Look>,
    looks: u32,
    /// Looks in a row from which nothing was given although something was seen.
    idle_looks: u32,
    /// Looks in a row in which nothing was seen.
    empty_looks: u32,
    /// Failed picks since the last success.
    failures: u32,
    last_exposure: Option<u64>,
    /// Poses of grasps that failed since the last success, of each arm.
    failed: Vec<Vec<Isometry3<f64>>>,
    assignments: u32,
    together: u32,
    plan_s: Vec<f64>,
    assign_s: Vec<f64>,
    /// Something has happened since the last assignment that may make another one possible.
    changed: bool,
    /// Something has happened since the last look that another one would show.
    is_stale: bool,
    looks_past_arms: u32,
    over_tray_s: Vec<f64>,
    /// Until when time has been counted, on the clock of the devices.
    counted_s: f64,
}

impl Lead<'_> {
    async fn run(mut self) -> Result<SortReport, SortError> {
        for arm in 0..self.arms.len() {
            self.order(arm, Order::Home);
        }
        let end = loop {
            match self.turn().await {
                Ok(None) => {}
                Ok(Some(end)) => break end,
                Err(error) => return Err(error),
            }
        };
        Ok(self.end(end).await)
    }

    /// One turn of the loop: gives what can be given, looks where nothing can, waits where somebody works.
    async fn turn(&mut self) -> Result<Option<End>, SortError> {
        self.count_time();
        self.show();
        let ending = self.must_end();
        self.wake_lost();
        if self.usable() == 0 {
            let why = self.arms.iter().map(|a| a.doing.to_string()).collect::<Vec<_>>().join("; ");
            return Ok(Some(End::ArmLost { why }));
        }
        if ending.is_none() && self.changed && self.look.is_some() && self.idle().next().is_some() {
            self.changed = false;
            self.give();
        }
        if self.is_working() && (ending.is_some() || !self.is_worth_a_look()) {
            return self.hear().await.map(|()| None);
        }
        if let Some(end) = ending {
            return Ok(Some(end));
        }
        // A look that gave nothing.
        if let Some(look) = &self.look
            && look.objects.iter().all(|o| o.waits)
        {
            if self.is_hoping() {
                // Somebody is about to come back; the tray is as it is.
                return self.hear().await.map(|()| None);
            }
            self.idle_looks += 1;
            if self.idle_looks >= self.config.recovery.no_grasp_frames {
                return Ok(Some(End::NoGrasp { why: self.why_idle() }));
            }
        }
        match self.look_again().await {
            Ok(()) => {
                let is_empty = self.empty_looks >= self.config.recovery.empty_frames && !self.is_working();
                Ok(is_empty.then_some(End::Empty))
            }
            Err(end) => Ok(Some(end)),
        }
    }

    fn must_end(&self) -> Option<End> {
        if self.observer.wants_end() {
            self.stop.store(true, Ordering::Relaxed);
            Some(End::Asked)
        } else if self.began.elapsed() >= seconds(self.config.run.time_limit_s) {
            Some(End::TimeLimit)
        } else if self.arms.iter().map(|a| a.trials).sum::<u32>() >= self.config.run.trials {
            Some(End::Trials)
        } else {
            None
        }
    }

    /// Arms that are or may yet be of use.
    fn usable(&self) -> usize {
        self.arms.iter().filter(|a| !matches!(a.doing, Doing::Out { .. })).count()
    }

    fn idle(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.arms.len()).filter(|&i| matches!(self.arms[i].doing, Doing::Idle { .. }))
    }

    /// True while some arm does something.
    fn is_working(&self) -> bool {
        self.arms.iter().any(|a| matches!(a.doing, Doing::Homing | Doing::Picking { .. }))
    }

    /// True where another look would show what is not known, and somebody is or will soon be there to take it. The first is
    /// for all arms together. An empty tray is looked at again when all are at home, for what they may have lost on the way.
    fn is_worth_a_look(&self) -> bool {
        let is_clear = self.arms.iter().all(|a| !a.is_over_tray);
        let may_look = is_clear || (self.config.sort.look_past_arms && self.looks > 0);
        self.is_stale && may_look && self.empty_looks == 0 && self.arms.iter().any(ArmState::is_coming)
    }

    /// Counts what the arms have done since the last time, to be asked before they do something else.
    fn count_time(&mut self) {
        let now_s = self.cell.clock.now_s();
        let seconds = now_s - std::mem::replace(&mut self.counted_s, now_s);
        for arm in &mut self.arms {
            arm.time.add(&arm.doing, arm.blocked, seconds);
        }
        let over = self.arms.iter().filter(|a| a.is_over_tray).count();
        if let Some(sum) = self.over_tray_s.get_mut(over) {
            *sum += seconds;
        }
    }

    /// True while some arm is lost that may come back.
    fn is_hoping(&self) -> bool {
        self.arms.iter().any(|a| matches!(a.doing, Doing::Lost { .. }))
    }

    fn why_idle(&self) -> String {
        let say = |(name, arm): (&String, &ArmState)| format!("{name}: {}", arm.doing);
        self.names.iter().zip(&self.arms).map(say).collect::<Vec<_>>().join("; ")
    }

    fn order(&self, arm: usize, order: Order) {
        // A worker that is gone tells so itself: its task has ended.
        self.arms[arm].orders.send(order).ok();
    }
}

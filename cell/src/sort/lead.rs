//! The loop of a sorting run: look, assign, dispatch, hear.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::{Arm, DepthCamera, Hand};
use graspd_assign::{Arm as Side, Assignment, Problem, Settings, assign};
use nalgebra::{Isometry3, Point3};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::config::SortConfig;
use super::objects::see;
use super::offer::{Look, Offer, PoolObject, Station, offer};
use super::record::{DecisionRecord, Given, SortRecorder};
use super::report::{ArmReport, SortReport, SortWitness};
use super::space::Space;
use super::table::{Doing, Row, SortEvent, SortObserver, Table};
use super::way::ArmShape;
use super::worker::{Notice, Order, Worker};
use crate::config::ConfigError;
use crate::frame::Frame;
use crate::observer::Silent;
use crate::outcome::{End, Holding, Outcome};
use crate::plan::{GraspPlanner, PlannerError};
use crate::record::RecordError;
use crate::run::{Asked, Cell, CellError, Chosen, answered, facts, looking, seconds};
use crate::steps::Step;

/// How often the loop looks up from waiting.
const TICK: Duration = Duration::from_millis(200);
/// Reports of workers are waited for at most so long at the end.
const LAST_WORDS: Duration = Duration::from_secs(120);

/// One arm of a cell.
#[derive(Debug, Clone)]
pub struct ArmCell {
    /// Carries the hand.
    pub arm: Arc<dyn Arm>,
    /// Grasps.
    pub hand: Arc<dyn Hand>,
    /// The space that the arm takes.
    pub shape: Arc<dyn ArmShape>,
}

/// Tells classes of objects, where somebody does: a detector in another camera, a scale, a simulation.
#[async_trait]
pub trait Recognizer: Send + Sync + std::fmt::Debug {
    /// Classes of what lies in the tray now, each with a point on or over the object, world frame.
    async fn classes(&self) -> Vec<(Point3<f64>, String)>;
}

/// A cell with several arms.
#[derive(Debug, Clone)]
pub struct SortCell {
    /// Sees the tray.
    pub camera: Arc<dyn DepthCamera>,
    /// In the order of the configuration.
    pub arms: Vec<ArmCell>,
    /// Plans grasps.
    pub planner: Arc<dyn GraspPlanner>,
    /// Tells classes.
    pub recognizer: Option<Arc<dyn Recognizer>>,
    /// Knows what became of objects, and who met whom.
    pub witness: Option<Arc<dyn SortWitness>>,
}

/// Why a sorting run does not begin.
#[derive(Debug, thiserror::Error)]
pub enum SortError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// One arm's part of the cell.
    #[error("{arm}: {source}")]
    Arm {
        /// The arm.
        arm: String,
        /// What is wrong.
        source: CellError,
    },
    /// The planner.
    #[error(transparent)]
    Planner(#[from] PlannerError),
    /// Arms that stand in each other's way at home or over their bins.
    #[error(
        "{first} and {second} stand in each other's way, at home or over their bins; set them farther apart"
    )]
    Ground {
        /// One.
        first: String,
        /// The other.
        second: String,
    },
    /// An arm that does not reach its own places.
    #[error("{arm}: {why}")]
    Home {
        /// The arm.
        arm: String,
        /// Which place, and why.
        why: String,
    },
    /// The folder of the record.
    #[error(transparent)]
    Record(#[from] RecordError),
}

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
    tail: Vec<graspd_assign::Capsule>,
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
    for arm in &config.arms {
        let facts = facts(&*cell.planner, &config.cell(arm), &mut Silent).await?;
        stations.push(Station::new(config, arm, facts));
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
            tail: Vec::new(),
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
        if self.is_working() {
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
            Ok(()) => Ok((self.empty_looks >= self.config.recovery.empty_frames).then_some(End::Empty)),
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

    /// Tries arms again that were lost long enough ago.
    fn wake_lost(&mut self) {
        let wait = seconds(self.config.sort.come_back_s);
        for i in 0..self.arms.len() {
            let due = self.arms[i].lost_at.is_some_and(|at| at.elapsed() >= wait);
            if due && matches!(self.arms[i].doing, Doing::Lost { .. }) {
                self.arms[i].lost_at = None;
                self.arms[i].doing = Doing::Homing;
                self.order(i, Order::ComeBack);
            }
        }
    }

    /// Waits for the next word of an arm, not for ever.
    async fn hear(&mut self) -> Result<(), SortError> {
        let tick = tokio::time::sleep(TICK);
        tokio::select! {
            biased;
            Some((arm, notice)) = self.notices.recv() => {
                self.on(arm, notice);
                // What else has been said by now.
                while let Ok((arm, notice)) = self.notices.try_recv() {
                    self.on(arm, notice);
                }
            }
            Some(ended) = self.workers.join_next() => match ended {
                Ok((arm, Err(source))) => {
                    return Err(SortError::Arm { arm: self.names[arm].clone(), source });
                }
                Ok((arm, Ok(()))) => self.out(arm, "its task has ended".to_owned()),
                Err(panicked) => tracing::error!(%panicked, "an arm's task has failed"),
            },
            () = tick => {}
        }
        for arm in self.space.expire(Instant::now()) {
            self.trouble(Some(arm), "no sign of life while it holds space: its space stays closed");
        }
        Ok(())
    }

    fn on(&mut self, arm: usize, notice: Notice) {
        self.space.renew(arm, Instant::now());
        match notice {
            Notice::Step(step) => {
                if let Doing::Picking { step: now, .. } = &mut self.arms[arm].doing {
                    *now = step;
                }
            }
            Notice::Lifted => {
                // The rest of its way is part of what it holds: nobody can be there.
                let tail = std::mem::take(&mut self.arms[arm].tail);
                if !tail.is_empty() && self.space.reserve(arm, tail, Instant::now()).is_ok() {
                    self.changed = true;
                }
            }
            Notice::Left => {
                self.space.release(arm);
                self.changed = true;
            }
            Notice::Trouble(text) => self.trouble(Some(arm), &text),
            Notice::Picked { outcome, trials, successes } => {
                self.picked(arm, &outcome);
                (self.arms[arm].trials, self.arms[arm].delivered) = (trials, successes);
                self.arms[arm].doing = Doing::Homing;
            }
            Notice::Home => {
                self.space.release(arm);
                let state = &mut self.arms[arm];
                if state.tries > 0 {
                    state.came_back += 1;
                    state.tries = 0;
                    // What it could not do, it or another can: but where things lie now, only a look tells.
                    self.look = None;
                }
                self.arms[arm].doing = Doing::Idle { why: String::new() };
                self.changed = true;
            }
            Notice::Lost { end, holding } => self.lost(arm, &end, holding),
            Notice::Ended(report) => self.arms[arm].report = Some(*report),
        }
    }

    fn picked(&mut self, arm: usize, outcome: &Outcome) {
        match outcome {
            Outcome::Success => {
                self.failures = 0;
                self.failed.iter_mut().for_each(Vec::clear);
            }
            Outcome::Failed { .. } => {
                self.failures += 1;
                let target = self.arms[arm].target.take();
                self.failed[arm].extend(target);
            }
            Outcome::NotExecuted { .. } | Outcome::Unknown { .. } => {}
        }
        if let Outcome::Failed { why, .. } | Outcome::NotExecuted { why } = outcome {
            self.trouble(Some(arm), why);
        }
    }

    /// An arm does not do what it is asked: what it was to take goes back to the others with the next look; its space
    /// stays closed.
    fn lost(&mut self, arm: usize, end: &End, holding: Holding) {
        self.space.doubt(arm);
        let held = if holding == Holding::Nothing { "" } else { " (with something in its hand, perhaps)" };
        let why = format!("{end}{held}");
        self.trouble(Some(arm), &why);
        let state = &mut self.arms[arm];
        state.lost += u32::from(state.tries == 0);
        state.tries += 1;
        let lasting = matches!(end, End::Failures { .. } | End::NoGrasp { .. } | End::Asked);
        if lasting || state.tries > self.config.recovery.tries {
            self.out(arm, why);
            return;
        }
        state.lost_at = Some(Instant::now());
        state.doing = Doing::Lost { why };
    }

    fn out(&mut self, arm: usize, why: String) {
        self.space.doubt(arm);
        self.arms[arm].lost_at = None;
        self.arms[arm].doing = Doing::Out { why };
    }

    fn trouble(&mut self, arm: Option<usize>, text: &str) {
        let name = arm.map(|i| self.names[i].clone());
        tracing::info!(arm = name.as_deref().unwrap_or("cell"), text, "trouble");
        self.observer.on(&SortEvent::Trouble { arm: name.as_deref(), text });
    }

    /// Gives grasps to the arms that are free.
    fn give(&mut self) {
        let Some(look) = self.look.take() else { return };
        let free: Vec<usize> = self.idle().collect();
        let began = std::time::Instant::now();
        let (found, sides) = self.assignment(&look, &free);
        self.assign_s.push(began.elapsed().as_secs_f64());
        self.assignments += 1;
        let time_s = self.began.elapsed().as_secs_f64();
        let (mut records, mut picks) = (Vec::new(), Vec::new());
        for ((&arm, decision), side) in free.iter().zip(&found.decisions).zip(&sides) {
            let mut given = None;
            if let (Some(chosen), Some(offer)) = (&decision.chosen, &look.offers[arm]) {
                let offered = &offer.grasps[side[chosen.grasp]];
                let object = &look.objects[offered.object];
                let rule = object.rule.map(|i| self.config.rules[i].name.clone()).unwrap_or_default();
                let f = chosen.factors;
                given = Some(Given {
                    object: offered.object,
                    width_m: object.seen.width_m,
                    rule,
                    bin: offered.bin.clone(),
                    rank: offered.rank,
                    value: chosen.value,
                    factors: [f.score, f.size, f.reach],
                });
                picks.push((arm, side[chosen.grasp]));
            }
            let reason = decision.reason.to_string();
            if given.is_none() {
                self.arms[arm].doing = Doing::Idle { why: reason.clone() };
            }
            records.push(DecisionRecord {
                time_s,
                look: look.number,
                arm: self.names[arm].clone(),
                given,
                reason,
            });
        }
        self.look = Some(look);
        for (arm, at) in picks {
            self.dispatch(arm, at);
        }
        if records.iter().any(|r| r.given.is_some()) || !self.is_working() {
            self.observer.on(&SortEvent::Decided(&records));
            let kept = self.recorder.as_mut().map_or(Ok(()), |r| r.decided(&records));
            self.note(kept);
        }
        self.show();
    }

    /// The assignment of what waits to the arms that are free; for each arm the places of its grasps in its offer.
    fn assignment(&self, look: &Look, free: &[usize]) -> (Assignment, Vec<Vec<usize>>) {
        let mut sides = Vec::with_capacity(free.len());
        let arms: Vec<Side> = free
            .iter()
            .map(|&arm| {
                let waiting = |offer: &Offer| {
                    let all = offer.grasps.iter().enumerate();
                    all.filter(|(_, g)| look.objects[g.object].waits).map(|(i, _)| i).collect::<Vec<_>>()
                };
                let of = look.offers[arm].as_ref();
                let places = of.map(waiting).unwrap_or_default();
                let grasps = of.map(|o| places.iter().map(|&i| o.grasps[i].grasp.clone()).collect());
                sides.push(places);
                let [min, max] = self.config.arms[arm].opening_m;
                Side {
                    opening_m: Some((min, max)),
                    ..Side::new(&self.names[arm], grasps.unwrap_or_default())
                }
            })
            .collect();
        let occupied = self.space.occupied(&self.names, free);
        let settings = Settings { clearance_m: self.config.sort.clearance_m, ..Settings::default() };
        let (began, limit) = (std::time::Instant::now(), seconds(self.config.sort.assign_s));
        let problem = Problem { arms: &arms, occupied: &occupied, taken: &[] };
        (assign(&problem, &settings, &mut || began.elapsed() > limit), sides)
    }

    /// Reserves the space of a grasp and sends the arm.
    fn dispatch(&mut self, arm: usize, at: usize) {
        let Some(look) = &mut self.look else { return };
        let Some(offer) = look.offers[arm].as_ref() else { return };
        let offered = &offer.grasps[at];
        // The assignment keeps corridors apart; the space has the last word.
        if let Err(refused) = self.space.reserve(arm, offered.corridor.clone(), Instant::now()) {
            let why = format!("{} is in the way", self.names[refused.holder]);
            self.arms[arm].doing = Doing::Idle { why };
            return;
        }
        let chosen = Chosen {
            frame: look.frame.clone(),
            question: offer.question.clone(),
            answer: offer.answer.clone(),
            out_of_reach: offer.out_of_reach.clone(),
            rank: offered.rank,
            drop: offered.drop,
        };
        let (object, bin) = (offered.object, offered.bin.clone());
        let pose = offered.grasp.world_from_hand;
        let tail = offered.corridor[offered.tail..].to_vec();
        // It and what lies against it: what is there after the pick only a look tells.
        let disturbed = self.config.sort.disturbed_m;
        let taken = look.objects[object].seen.clone();
        look.objects[object].waits = false;
        for other in &mut look.objects {
            other.waits &= other.seen.gap(&taken) > disturbed;
        }
        let others = self.arms.iter().filter(|a| matches!(a.doing, Doing::Picking { .. })).count();
        self.together += u32::from(others > 0);
        self.idle_looks = 0;
        self.arms[arm].target = Some(pose);
        self.arms[arm].tail = tail;
        self.arms[arm].doing = Doing::Picking { object, bin, step: Step::Open };
        self.order(arm, Order::Pick(Box::new(chosen)));
    }

    /// Looks into the tray and plans for every hand that is there.
    async fn look_again(&mut self) -> Result<(), End> {
        self.look = None;
        let frame = self.capture().await?;
        self.looks += 1;
        let mut objects: Vec<PoolObject> = see(&frame, &self.config.tray, self.config.sort.object_height_m)
            .into_iter()
            .map(|seen| PoolObject { seen, rule: None, waits: true })
            .collect();
        let classes = match &self.cell.recognizer {
            Some(recognizer) => recognizer.classes().await,
            None => Vec::new(),
        };
        for object in &mut objects {
            let near = |(point, _): &&(Point3<f64>, String)| object.seen.distance(point) < 0.02;
            let class = classes.iter().find(near).map(|(_, class)| class.as_str());
            object.rule = self.config.rules.iter().position(|r| r.fits(object.seen.width_m, class));
        }
        let asked = |arm: usize| {
            let number = u64::from(self.looks - 1) * self.arms.len() as u64 + arm as u64;
            let asked = Asked {
                number,
                idle: self.idle_looks,
                failures: self.failures,
                seemed_empty: self.empty_looks > 0,
            };
            asked.question(&self.config.cell(&self.config.arms[arm])).as_recorded()
        };
        let arms: Vec<usize> = self.idle().collect();
        let questions: Result<Vec<_>, _> = arms.iter().map(|&arm| asked(arm)).collect();
        let questions = questions.map_err(|e| End::PlannerRefused { why: e.to_string() })?;
        let began = Instant::now();
        let answers = self.plan(&frame, &questions).await?;
        self.plan_s.push(began.elapsed().as_secs_f64());
        let empty = |a: &crate::plan::Answer| a.no_grasp.as_ref().is_some_and(|n| n.reason.is_empty_tray());
        if !answers.is_empty() && answers.iter().all(empty) {
            self.empty_looks += 1;
            return Ok(());
        }
        self.empty_looks = 0;
        let mut offers: Vec<Option<Offer>> = (0..self.arms.len()).map(|_| None).collect();
        for ((&arm, question), answer) in arms.iter().zip(questions).zip(answers) {
            let parts = (&self.cell.arms[arm], &self.stations[arm]);
            let around = (&self.space, &self.failed[arm][..]);
            offers[arm] = Some(offer(self.config, arm, parts, (question, answer), &objects, around));
        }
        self.changed = true;
        self.look = Some(Look { number: self.looks, frame, objects, offers });
        Ok(())
    }

    /// A new frame; tried again with a growing wait.
    async fn capture(&mut self) -> Result<Frame, End> {
        let (rules, camera) = (&self.config.recovery, &self.config.camera);
        let (limit, max_age) = (seconds(self.config.timeouts.capture_s), seconds(camera.max_age_s));
        let mut before = 0;
        loop {
            let patience = limit.mul_f64(self.config.timeouts.patience);
            let why = match tokio::time::timeout(patience, self.cell.camera.capture(max_age, limit)).await {
                Err(_) => format!("the camera has not answered for {patience:?}"),
                Ok(Err(error)) => error.to_string(),
                Ok(Ok(frame)) if frame.age > max_age => format!("a frame {:?} old", frame.age),
                Ok(Ok(frame)) if self.last_exposure == Some(frame.sequence) => {
                    "the same exposure again".into()
                }
                Ok(Ok(frame)) => {
                    self.last_exposure = Some(frame.sequence);
                    let pose = looking(&camera.position_m, &camera.looks_at_m);
                    return Frame::of(&frame, &pose).map_err(|e| End::CameraLost { why: e.to_string() });
                }
            };
            self.trouble(None, &why);
            if before >= rules.tries {
                return Err(End::CameraLost { why });
            }
            tokio::time::sleep(rules.backoff(before)).await;
            before += 1;
        }
    }

    /// Answers of all hands. A planner that is away is waited for until the time limit.
    async fn plan(
        &mut self,
        frame: &Frame,
        questions: &[crate::plan::Question],
    ) -> Result<Vec<crate::plan::Answer>, End> {
        let limit = seconds(self.config.timeouts.plan_s);
        let (mut before, mut failed) = (0, 0);
        loop {
            let asked = answered(limit, self.cell.planner.plan_together(frame, questions, limit)).await;
            let error = match asked {
                Ok(answers) if answers.len() == questions.len() => return Ok(answers),
                Ok(_) => PlannerError::Failed("not every hand was answered".to_owned()),
                Err(error) => error,
            };
            let why = error.to_string();
            self.trouble(None, &why);
            match error {
                PlannerError::Refused(_) => return Err(End::PlannerRefused { why }),
                PlannerError::Failed(_) if failed >= self.config.recovery.tries => {
                    return Err(End::PlannerLost { why });
                }
                PlannerError::Failed(_) => failed += 1,
                PlannerError::Away(_) => {}
            }
            match self.must_end() {
                Some(End::TimeLimit) => return Err(End::PlannerLost { why }),
                Some(end) => return Err(end),
                None => tokio::time::sleep(self.config.recovery.backoff(before)).await,
            }
            before += 1;
        }
    }

    fn table(&self) -> Table {
        let row = |(i, arm): (usize, &ArmState)| Row {
            arm: self.names[i].clone(),
            hand: self.config.arms[i].hand.id.clone(),
            doing: arm.doing.clone(),
            leased: self.space.holds(i),
            delivered: arm.delivered,
            trials: arm.trials,
        };
        let waiting = self.look.as_ref().map_or(0, |l| l.objects.iter().filter(|o| o.waits).count());
        Table { rows: self.arms.iter().enumerate().map(row).collect(), looks: self.looks, waiting }
    }

    fn show(&mut self) {
        let table = self.table();
        self.observer.on(&SortEvent::Table(&table));
    }

    fn note(&mut self, kept: Result<(), RecordError>) {
        if let Err(error) = kept {
            tracing::warn!(%error, "the record is incomplete");
            self.record_trouble.get_or_insert_with(|| error.to_string());
        }
    }

    /// Ends every arm's run and sums up.
    async fn end(mut self, end: End) -> SortReport {
        for arm in 0..self.arms.len() {
            self.order(arm, Order::End(end.clone()));
        }
        let deadline = Instant::now() + LAST_WORDS;
        while self.arms.iter().any(|a| a.report.is_none()) {
            match tokio::time::timeout_at(deadline, self.notices.recv()).await {
                Ok(Some((arm, notice))) => self.on(arm, notice),
                _ => break,
            }
        }
        self.workers.shutdown().await;
        let truth = match &self.cell.witness {
            Some(witness) => witness.truth().await,
            None => None,
        };
        let arms = (self.names.iter().zip(&mut self.arms).zip(&self.stations))
            .map(|((name, arm), station)| ArmReport {
                arm: name.clone(),
                report: arm.report.take().unwrap_or_else(|| crate::report::Report {
                    hand: station.facts.id.clone(),
                    hand_revision: station.facts.revision.clone(),
                    end: End::ArmLost { why: "it said no last word".to_owned() },
                    holding: Holding::Unknown,
                    tally: crate::report::Tally::default(),
                    duration_s: self.began.elapsed().as_secs_f64(),
                    record_trouble: None,
                }),
                lost: arm.lost,
                came_back: arm.came_back,
            })
            .collect();
        let mut report = SortReport {
            end,
            arms,
            looks: self.looks,
            assignments: self.assignments,
            together: self.together,
            plan_s: std::mem::take(&mut self.plan_s),
            assign_s: std::mem::take(&mut self.assign_s),
            duration_s: self.began.elapsed().as_secs_f64(),
            truth,
            record_trouble: None,
        };
        let kept = self.recorder.as_ref().map_or(Ok(()), |r| r.finish(&report));
        self.note(kept);
        report.record_trouble.clone_from(&self.record_trouble);
        report
    }
}

//! The link to a controller, looked after by a task: state in, heartbeat and commands out, back-off when it breaks.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{broadcast, mpsc, oneshot, watch};
use tokio::time::{Instant, MissedTickBehavior};

use crate::config::UrConfig;
use crate::events::UrEvent;
use crate::rtde::{Package, Recipe, RtdeError, RtdeLink, Value, Version};
use crate::script::{BEAT_FIELDS, COMMAND_FIELDS, Command, CommandKind, STREAM_FIELDS};
use crate::state::RobotState;

/// The newest that is known.
#[derive(Debug, Clone)]
pub(crate) enum Status {
    /// No link; why.
    Down(String),
    /// A frame.
    Up(Arc<RobotState>),
}

/// What the task is asked to send.
#[derive(Debug)]
pub(crate) enum Order {
    /// A command with its number; the reply says that it was written.
    Command { number: i32, command: Command, written: oneshot::Sender<()> },
    /// Stop; only if the command of that number is the newest.
    Stop { only: Option<i32>, written: Option<oneshot::Sender<i32>> },
    /// A target of a stream.
    Target { number: i32, target: [f64; 6] },
}

/// Shared by the arm and its tasks.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) config: UrConfig,
    pub(crate) status: watch::Sender<Status>,
    pub(crate) events: broadcast::Sender<UrEvent>,
    /// Number of the newest command.
    newest: AtomicI32,
    /// The newest words of the primary interface.
    words: Mutex<VecDeque<String>>,
}

impl Shared {
    pub(crate) fn new(config: UrConfig) -> Self {
        let status = watch::Sender::new(Status::Down("not connected yet".into()));
        let events = broadcast::Sender::new(64);
        Self { config, status, events, newest: AtomicI32::new(0), words: Mutex::default() }
    }

    /// A number for a command: never 0, never the last one.
    pub(crate) fn next_number(&self) -> i32 {
        let next = |n: i32| Some(if n >= 1_000_000_000 { 1 } else { n + 1 });
        match self.newest.fetch_update(Ordering::SeqCst, Ordering::SeqCst, next) {
            Ok(before) => next(before).unwrap_or(1),
            Err(before) => before,
        }
    }

    /// Numbers go on after this one, the one that a new script takes for old. Never back to one that was given out: its
    /// caller may still wait, and would take the answer to another command for its own.
    pub(crate) fn begin_after(&self, number: i32) {
        self.newest.fetch_max(number.clamp(0, 1_000_000_000), Ordering::SeqCst);
    }

    pub(crate) fn newest(&self) -> i32 {
        self.newest.load(Ordering::SeqCst)
    }

    pub(crate) fn words(&self) -> MutexGuard<'_, VecDeque<String>> {
        self.words.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn tell(&self, event: UrEvent) {
        // Nobody listens: nobody hears.
        let _unheard = self.events.send(event);
    }
}

/// A link that is set up.
struct Ready {
    link: RtdeLink,
    outputs: Recipe,
    beat: Option<Recipe>,
    command: Option<Recipe>,
    stream: Option<Recipe>,
}

/// Looks after the link until it is aborted.
pub(crate) async fn run(shared: Arc<Shared>, mut orders: mpsc::UnboundedReceiver<Order>) {
    let config = &shared.config;
    let first = Duration::from_secs_f64(config.first_pause_s);
    let mut pause = first;
    let mut beat = 0;
    loop {
        let began = Instant::now();
        let why = match connect(config).await {
            Ok(ready) => {
                shared.tell(UrEvent::Connected { version: ready.link.version() });
                // What was asked before is not done now: it is too late.
                while orders.try_recv().is_ok() {}
                let Err(error) = drive(&shared, ready, &mut orders, &mut beat).await;
                error.to_string()
            }
            Err(error) => error.to_string(),
        };
        tracing::warn!(arm = config.name, why, "no link to the controller");
        let was_up = matches!(*shared.status.borrow(), Status::Up(_));
        shared.status.send_replace(Status::Down(why.clone()));
        if was_up {
            shared.tell(UrEvent::Disconnected { why });
        }
        if began.elapsed() > Duration::from_secs(2) + pause {
            pause = first;
        }
        let until = Instant::now() + pause;
        loop {
            tokio::select! {
                () = tokio::time::sleep_until(until) => break,
                order = orders.recv() => if order.is_none() {
                    return;
                },
            }
        }
        pause = (2 * pause).min(Duration::from_secs_f64(config.longest_pause_s.max(config.first_pause_s)));
    }
}

/// Frames a second that a controller gives at most.
fn most_hz(version: Version) -> f64 {
    if version[0] >= 5 { 500.0 } else { 125.0 }
}

async fn connect(config: &UrConfig) -> Result<Ready, RtdeError> {
    let limit = Duration::from_secs_f64(config.connect_timeout_s);
    let address = (config.host.as_str(), config.ports.rtde);
    let late = |step: &str| {
        RtdeError::Link(format!("{}:{}: {step}: no answer within {limit:?}", address.0, address.1))
    };
    let connecting = tokio::time::timeout(limit, RtdeLink::connect(address)).await;
    let mut link = connecting.map_err(|_| late("connect"))?.map_err(|e| match e {
        RtdeError::Link(why) => RtdeError::Link(format!("{}:{}: {why}", address.0, address.1)),
        other => other,
    })?;
    let setup = async {
        let most = most_hz(link.version());
        let hz = if config.frequency_hz == 0.0 { most } else { config.frequency_hz.min(most) };
        let names = RobotState::FIELDS;
        let outputs = match link.set_up_outputs(hz, &names).await {
            // Older software does not tell the offset of the tool.
            Err(RtdeError::UnknownField { field }) if field == "tcp_offset" => {
                link.set_up_outputs(hz, &names[..names.len() - 1]).await?
            }
            outputs => outputs?,
        };
        // Who does not move writes nothing: several may watch one arm.
        let (mut beat, mut command, mut stream) = (None, None, None);
        if config.armed {
            beat = Some(link.set_up_inputs(&BEAT_FIELDS).await?);
            command = Some(link.set_up_inputs(&COMMAND_FIELDS).await?);
            stream = Some(link.set_up_inputs(&STREAM_FIELDS).await?);
        }
        link.start().await?;
        Ok::<_, RtdeError>((outputs, beat, command, stream))
    };
    let (outputs, beat, command, stream) =
        tokio::time::timeout(limit, setup).await.map_err(|_| late("set-up"))??;
    Ok(Ready { link, outputs, beat, command, stream })
}

/// Exchanges until the link breaks.
async fn drive(
    shared: &Shared,
    mut ready: Ready,
    orders: &mut mpsc::UnboundedReceiver<Order>,
    beat: &mut i32,
) -> Result<std::convert::Infallible, RtdeError> {
    let silence = Duration::from_secs_f64(shared.config.silence_s);
    let mut clock = tokio::time::interval(Duration::from_secs_f64(shared.config.heartbeat.period_s));
    clock.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut heard = Instant::now();
    let mut targets = 0;
    // Whoever waited for a motion was told that the link broke. A link that is back before the script misses its
    // heartbeat must not let that motion go on.
    carry_out(shared, &mut ready, Order::Stop { only: None, written: None }, &mut targets).await?;
    loop {
        tokio::select! {
            package = tokio::time::timeout_at(heard + silence, ready.link.next()) => {
                let quiet = || RtdeError::Link(format!("no frame of state within {silence:?}"));
                match package.map_err(|_| quiet())?? {
                    Package::Data { recipe, bytes } => {
                        heard = Instant::now();
                        publish(shared, RobotState::from_values(&ready.outputs.decode(recipe, &bytes)?)?);
                    }
                    Package::Text(text) => {
                        tracing::warn!(text = text.text, source = text.source, "controller");
                        shared.tell(UrEvent::Text { text: text.text });
                    }
                    other => tracing::debug!(?other, "not asked for"),
                }
            }
            _ = clock.tick() => if let Some(recipe) = &ready.beat {
                *beat = beat.wrapping_add(1);
                let package = recipe.encode(&[Value::Int32(*beat)])?;
                send(shared, &mut ready.link, &package).await?;
            },
            order = orders.recv() => {
                let Some(order) = order else { return Err(RtdeError::Link("given up".into())) };
                carry_out(shared, &mut ready, order, &mut targets).await?;
            }
        }
    }
}

async fn send(shared: &Shared, link: &mut RtdeLink, package: &[u8]) -> Result<(), RtdeError> {
    let limit = Duration::from_secs_f64(shared.config.connect_timeout_s);
    let sent = tokio::time::timeout(limit, link.send(package)).await;
    sent.map_err(|_| RtdeError::Link(format!("the controller takes nothing within {limit:?}")))?
}

async fn carry_out(
    shared: &Shared,
    ready: &mut Ready,
    order: Order,
    targets: &mut i32,
) -> Result<(), RtdeError> {
    let (Some(command_recipe), Some(stream_recipe)) = (&ready.command, &ready.stream) else {
        // Not armed: nothing is ever written. The reply's sender is dropped, which the caller hears.
        return Ok(());
    };
    match order {
        Order::Command { number, command, written } => {
            // A caller that has gone wants nothing any more; one that was replaced neither.
            if written.is_closed() || shared.newest() != number {
                return Ok(());
            }
            let package = command_recipe.encode(&command.values(number))?;
            send(shared, &mut ready.link, &package).await?;
            let _gone = written.send(());
        }
        Order::Stop { only, written } => {
            if only.is_some_and(|number| shared.newest() != number) {
                return Ok(());
            }
            let number = shared.next_number();
            let package = command_recipe.encode(&Command::new(CommandKind::Stop).values(number))?;
            send(shared, &mut ready.link, &package).await?;
            if let Some(written) = written {
                let _gone = written.send(number);
            }
        }
        Order::Target { number, target } => {
            if shared.newest() == number {
                *targets = targets.wrapping_add(1);
                let mut values: Vec<Value> = target.iter().map(|v| Value::Double(*v)).collect();
                values.push(Value::Int32(*targets));
                let package = stream_recipe.encode(&values)?;
                send(shared, &mut ready.link, &package).await?;
            }
        }
    }
    Ok(())
}

fn publish(shared: &Shared, state: RobotState) {
    let before = shared.status.send_replace(Status::Up(Arc::new(state.clone())));
    let (safety, mode, running) = match &before {
        Status::Up(before) => (Some(before.safety), Some(before.robot_mode), Some(before.program_running)),
        Status::Down(_) => (None, None, None),
    };
    if safety != Some(state.safety) {
        shared.tell(UrEvent::Safety { from: safety, to: state.safety });
    }
    if mode != Some(state.robot_mode) {
        shared.tell(UrEvent::RobotMode { from: mode, to: state.robot_mode });
    }
    if running.is_some_and(|running| running != state.program_running) {
        shared.tell(UrEvent::Program { running: state.program_running });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_number_is_given_out_twice() {
        let shared = Shared::new(UrConfig::default());
        let given: Vec<i32> = (0..3).map(|_| shared.next_number()).collect();
        assert_eq!(given, [1, 2, 3]);
        // A new script has taken number 1 for old, while callers of 2 and 3 may still wait.
        shared.begin_after(1);
        assert_eq!(shared.next_number(), 4);
        // Another client had come further.
        shared.begin_after(500);
        assert_eq!(shared.next_number(), 501);
        shared.begin_after(i32::MAX);
        assert_eq!(shared.next_number(), 1);
    }
}

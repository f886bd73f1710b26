//! Faults by name and time, as people write them: `protective-stop@5`, `mute@3+0.5`, `rtde:delay=0.1`, `garble=3`.
//!
//! `NAME[=VALUE][@AT][+LASTS]`: what, how much, how many seconds after the start (0 where it is left out), and for how
//! many seconds (for good where it is left out; faults that are over at once take none).

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use crate::dynamixel::BusEmulator;
use crate::faults::{Garble, LinkFaults, Misbehaviour};
use crate::robotiq::Gripper;
use crate::ur::UrEmulator;

/// Why a request is none.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("fault: found {found:?}, expected {expected}")]
pub struct FaultError {
    /// Found words.
    pub found: String,
    /// What is expected.
    pub expected: String,
}

/// Which kind of device faults are asked of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultyDevice {
    /// The emulated arm.
    Ur,
    /// The emulated gripper.
    Robotiq,
    /// The emulated bus of motors.
    Dynamixel,
}

/// What a fault's value stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Value {
    None,
    Seconds,
    Count,
    Code,
    Motor,
}

/// Name, value, whether it can last, and what it does.
type Known = (&'static str, Value, bool, &'static str);

const WIRE: &[Known] = &[
    ("cut", Value::None, false, "connections are cut"),
    ("mute", Value::None, true, "nothing is answered"),
    ("refuse", Value::None, true, "new connections are closed at once"),
    ("delay", Value::Seconds, true, "each answer waits so long"),
    ("pieces", Value::Count, true, "answers come in pieces of so many bytes"),
    ("garble", Value::Count, false, "so many answers are damaged"),
];
const UR: &[Known] = &[
    ("protective-stop", Value::None, false, "the arm stops itself"),
    ("emergency-stop", Value::None, true, "the button is pressed"),
    ("safeguard", Value::None, true, "the safeguard input is open"),
    ("violation", Value::None, false, "a safety limit is violated"),
    ("local", Value::None, true, "control is the pendant's"),
    ("stop-program", Value::None, false, "the pendant's stop button"),
];
const LINE: &[Known] = &[
    ("garble", Value::Count, false, "the check of so many answers is wrong"),
    ("cut", Value::Count, false, "only half of so many answers is sent"),
    ("mute", Value::Count, false, "so many answers are not sent"),
    ("noise", Value::Count, false, "stray bytes before so many answers"),
    ("slow", Value::Seconds, true, "each answer comes so much later"),
    ("hang-up", Value::Seconds, false, "the line is away for so long"),
];
const ROBOTIQ: &[Known] = &[
    ("fault", Value::Code, true, "a fault of the gripper by its code, such as 0x0e: over-current"),
    ("power-cycle", Value::None, false, "power is away for a moment"),
    ("unreachable", Value::None, true, "the arm's gripper software does not reach it"),
];
const DYNAMIXEL: &[Known] = &[
    ("overload", Value::Motor, false, "the motor reports overload"),
    ("overheat", Value::Motor, false, "the motor reports overheating"),
    ("unplug", Value::Motor, true, "the motor is off the bus"),
    ("power-cycle", Value::Motor, false, "the motor's power is away for a moment"),
];

/// Links of an arm by name.
const LINKS: [&str; 3] = ["rtde", "dashboard", "scripts"];

impl FaultyDevice {
    fn known(self) -> impl Iterator<Item = &'static Known> {
        let (first, second) = match self {
            Self::Ur => (UR, WIRE),
            Self::Robotiq => (ROBOTIQ, LINE),
            Self::Dynamixel => (DYNAMIXEL, LINE),
        };
        first.iter().chain(second)
    }

    /// Each fault that it can have: how it is written, what it does.
    pub fn faults(self) -> Vec<(String, &'static str)> {
        self.known()
            .map(|(name, value, lasts, does)| {
                let value = match value {
                    Value::None => "",
                    Value::Seconds => "=SECONDS",
                    Value::Count => "=COUNT",
                    Value::Code => "=CODE",
                    Value::Motor => "=MOTOR",
                };
                (format!("{name}{value}[@AT]{}", if *lasts { "[+LASTS]" } else { "" }), *does)
            })
            .collect()
    }
}

/// A fault to come.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultRequest {
    /// Which, as it was written.
    name: &'static str,
    /// Which of an arm's links; `None`: all.
    link: Option<&'static str>,
    value: f64,
    at: Duration,
    lasts: Option<Duration>,
}

impl fmt::Display for FaultRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let link = self.link.map(|l| format!("{l}:")).unwrap_or_default();
        write!(f, "{link}{}", self.name)
    }
}

impl FaultRequest {
    /// Reads a request for a device.
    ///
    /// # Errors
    /// [`FaultError`] that lists what this device can do wrong.
    pub fn parse(device: FaultyDevice, text: &str) -> Result<Self, FaultError> {
        let wrong = |expected: String| FaultError { found: text.to_owned(), expected };
        let seconds = |word: &str| {
            let value = f64::from_str(word).ok().filter(|v| (0.0..=86_400.0).contains(v));
            value.map(Duration::from_secs_f64).ok_or_else(|| wrong(format!("seconds instead of {word:?}")))
        };
        let (rest, lasts) = match text.split_once('+') {
            Some((rest, lasts)) => (rest, Some(seconds(lasts)?)),
            None => (text, None),
        };
        let (rest, at) = match rest.split_once('@') {
            Some((rest, at)) => (rest, seconds(at)?),
            None => (rest, Duration::ZERO),
        };
        let (rest, value) = match rest.split_once('=') {
            Some((rest, value)) => (rest, Some(value)),
            None => (rest, None),
        };
        let (link, name) = match rest.split_once(':') {
            Some((link, name)) => {
                let known = LINKS.iter().find(|l| **l == link && device == FaultyDevice::Ur);
                let expected = || wrong(format!("one of the arm's links {LINKS:?} before the colon"));
                (Some(*known.ok_or_else(expected)?), name)
            }
            None => (None, rest),
        };
        let known = device.known().find(|(known, ..)| *known == name);
        let Some((name, kind, can_last, _)) = known else {
            let all: Vec<String> = device.faults().into_iter().map(|(written, _)| written).collect();
            return Err(wrong(format!("one of {}", all.join(", "))));
        };
        if link.is_some() && !WIRE.iter().any(|(wire, ..)| wire == name) {
            return Err(wrong(format!("{name} without a link: it is the arm's")));
        }
        if lasts.is_some() && !can_last {
            return Err(wrong(format!("{name} without `+`: it is over at once")));
        }
        let value = match (kind, value) {
            (Value::None, None) => 0.0,
            (Value::None, Some(_)) => return Err(wrong(format!("{name} without a value"))),
            (Value::Seconds, Some(word)) => seconds(word)?.as_secs_f64(),
            (Value::Count, None) => 1.0,
            (_, None) => return Err(wrong(format!("{name} with a value"))),
            (kind, Some(word)) => {
                let digits = word.strip_prefix("0x");
                let number = digits.map_or_else(|| word.parse(), |d| u32::from_str_radix(d, 16));
                let most = if *kind == Value::Count { 1_000_000 } else { 252 };
                let number = number.ok().filter(|n| *n <= most);
                f64::from(number.ok_or_else(|| wrong(format!("a whole number up to {most}")))?)
            }
        };
        Ok(Self { name, link, value, at, lasts })
    }

    /// The value as the whole number that it was checked to be.
    fn whole(&self) -> u32 {
        self.value as u32
    }
}

/// Does what was requested when its time comes, and ends it; ready when all is done.
pub async fn carry_out(mut requests: Vec<FaultRequest>, befall: impl Fn(&FaultRequest, bool)) {
    let began = tokio::time::Instant::now();
    requests.sort_by_key(|r| r.at);
    let mut events: Vec<(Duration, &FaultRequest, bool)> = Vec::new();
    for request in &requests {
        events.push((request.at, request, true));
        events.extend(request.lasts.map(|lasts| (request.at + lasts, request, false)));
    }
    events.sort_by_key(|(at, ..)| *at);
    for (at, request, begins) in events {
        tokio::time::sleep_until(began + at).await;
        tracing::info!(fault = %request, begins, "fault on request");
        befall(request, begins);
    }
}

/// A fault of a link of an arm begins or ends.
fn on_wire(faults: &LinkFaults, request: &FaultRequest, begins: bool) {
    let usual = Misbehaviour::default();
    faults.change(|now| match request.name {
        "mute" => now.mute = begins,
        "refuse" => now.refuse = begins,
        "delay" if begins => now.delay = Duration::from_secs_f64(request.value),
        "delay" => now.delay = usual.delay,
        "pieces" if begins => {
            now.pieces = Some((request.whole().max(1) as usize, Duration::from_micros(200)));
        }
        "pieces" => now.pieces = usual.pieces,
        "garble" => now.garble = Some(Garble { packets: request.whole(), at: 9, mask: 0x55 }),
        _ => {}
    });
    if request.name == "cut" {
        faults.cut();
    }
}

/// A fault of a serial line begins or ends.
fn on_line(faults: &LinkFaults, request: &FaultRequest, begins: bool) {
    let time = Duration::from_secs_f64(if begins { request.value } else { 0.0 });
    match request.name {
        "garble" => faults.garble(request.whole()),
        "cut" => faults.change(|now| now.halve = request.whole()),
        "mute" => faults.change(|now| now.lose = request.whole()),
        "noise" => faults.change(|now| now.noise = request.whole()),
        "slow" => faults.change(|now| now.delay = time),
        "hang-up" => faults.hang_up(time),
        _ => {}
    }
}

/// Does a request to an arm.
pub fn befall_ur(emulator: &UrEmulator, request: &FaultRequest, begins: bool) {
    match request.name {
        "protective-stop" => emulator.protective_stop("requested"),
        "emergency-stop" => emulator.emergency_stop(begins),
        "safeguard" => emulator.safeguard(begins),
        "violation" => emulator.violation(),
        "local" => emulator.set_remote_control(!begins),
        "stop-program" => emulator.stop_program(),
        _ => {
            let faults = emulator.faults();
            for (name, link) in LINKS.iter().zip([&faults.rtde, &faults.dashboard, &faults.scripts]) {
                if request.link.is_none_or(|asked| asked == *name) {
                    on_wire(link, request, begins);
                }
            }
        }
    }
}

/// Does a request to a gripper, whose lines are these.
pub fn befall_gripper(gripper: &Gripper, lines: &[LinkFaults], request: &FaultRequest, begins: bool) {
    match request.name {
        "fault" => gripper.fault(if begins { request.whole() as u8 } else { 0 }),
        "power-cycle" => gripper.power_cycle(),
        "unreachable" => gripper.out_of_reach(begins),
        _ => lines.iter().for_each(|line| on_line(line, request, begins)),
    }
}

/// Does a request to a bus of motors.
pub fn befall_bus(bus: &BusEmulator, request: &FaultRequest, begins: bool) {
    let id = request.whole() as u8;
    match request.name {
        "overload" => bus.raise(id, 1 << 5),
        "overheat" => bus.raise(id, 1 << 2),
        "unplug" => bus.unplug(id, begins),
        "power-cycle" => bus.power_cycle(id),
        _ => on_line(bus.faults(), request, begins),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ur(text: &str) -> Result<FaultRequest, String> {
        FaultRequest::parse(FaultyDevice::Ur, text).map_err(|e| e.to_string())
    }

    #[test]
    fn requests_are_read_as_they_are_written() {
        let stop = ur("protective-stop@5").unwrap();
        assert_eq!((stop.name, stop.at, stop.lasts), ("protective-stop", Duration::from_secs(5), None));
        let mute = ur("rtde:mute@3+0.5").unwrap();
        assert_eq!((mute.link, mute.lasts), (Some("rtde"), Some(Duration::from_millis(500))));
        assert_eq!(ur("garble=3").unwrap().value, 3.0);
        let code = FaultRequest::parse(FaultyDevice::Robotiq, "fault=0x0e@1+2").unwrap();
        assert_eq!(code.whole(), 14);
        for (text, expected) in [
            ("explode", "expected one of protective-stop[@AT], emergency-stop[@AT][+LASTS]"),
            ("protective-stop+3", "without `+`"),
            ("dashboard:violation", "without a link"),
            ("usb:mute", "one of the arm's links"),
            ("delay", "with a value"),
            ("local=3", "without a value"),
            ("pieces=x", "a whole number"),
            ("mute@-1", "seconds instead of \"-1\""),
            ("mute@nan", "seconds instead of"),
        ] {
            let error = ur(text).unwrap_err();
            assert!(error.contains(expected), "{error}\nshould contain\n{expected}");
        }
        assert!(FaultRequest::parse(FaultyDevice::Dynamixel, "overload=300").is_err());
        assert!(FaultRequest::parse(FaultyDevice::Dynamixel, "rtde:mute").is_err());
    }

    #[tokio::test(start_paused = true)]
    async fn faults_begin_and_end_in_their_order() {
        let requests = ["mute@2+3", "cut@1", "delay=0.1@4"].map(|text| ur(text).unwrap());
        let seen = std::sync::Mutex::new(Vec::new());
        let began = tokio::time::Instant::now();
        carry_out(requests.to_vec(), |request, begins| {
            seen.lock().unwrap().push((request.to_string(), begins, began.elapsed().as_secs()));
        })
        .await;
        let seen = seen.into_inner().unwrap();
        let expected = [("cut", true, 1), ("mute", true, 2), ("delay", true, 4), ("mute", false, 5)];
        let seen: Vec<_> = seen.iter().map(|(name, begins, at)| (name.as_str(), *begins, *at)).collect();
        assert_eq!(seen, expected);
    }

    #[test]
    fn what_begins_on_a_wire_ends_there() {
        let faults = LinkFaults::default();
        for text in ["mute@1+1", "delay=0.2", "pieces=7", "refuse"] {
            let request = ur(text).unwrap();
            on_wire(&faults, &request, true);
            assert_ne!(faults.current(), Misbehaviour::default(), "{text}");
            on_wire(&faults, &request, false);
            assert_eq!(faults.current(), Misbehaviour::default(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[a-z:=@+0-9.x-]{0,30}") {
            for device in [FaultyDevice::Ur, FaultyDevice::Robotiq, FaultyDevice::Dynamixel] {
                let _request = FaultRequest::parse(device, &text);
            }
        }
    }
}

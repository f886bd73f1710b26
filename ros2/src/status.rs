//! What the bridge says of itself: `~/status` as JSON and `/diagnostics`, from the same figures.

use std::time::Duration;

use serde_json::{Value, json};

use crate::link::LinkState;
use crate::messages::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Stamp, level};

/// How frames are.
#[derive(Debug, Clone, PartialEq)]
pub enum FrameState {
    /// There is a frame to plan on.
    Ready {
        /// Its optical frame.
        frame_id: String,
        /// Its stamp.
        stamp: Stamp,
        /// Since it has come.
        age: Duration,
    },
    /// There is none, or none that can be used.
    Unusable {
        /// `NO_FRAME`, `FRAME_TOO_OLD` or `INVALID_FRAME`: what a goal would be refused for.
        reason: &'static str,
        /// For people.
        message: String,
    },
}

/// A goal under way.
#[derive(Debug, Clone, PartialEq)]
pub struct GoalState {
    /// Its id.
    pub id: String,
    /// The hand.
    pub hand: String,
    /// `waiting`, `accepted` or `improving`.
    pub phase: &'static str,
    /// Since it began.
    pub elapsed: Duration,
}

/// Everything of a moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// The node's full name.
    pub node: String,
    /// The server's address.
    pub server: String,
    /// How it is.
    pub link: LinkState,
    /// How frames are.
    pub frame: FrameState,
    /// Depth images that have come.
    pub images: u64,
    /// Goals under way, by id.
    pub goals: Vec<GoalState>,
    /// Goals that have ended, by state.
    pub ended: Vec<(&'static str, u64)>,
    /// The bridge is ending.
    pub stopping: bool,
}

impl Snapshot {
    fn server(&self) -> (u8, &'static str, &str) {
        match &self.link {
            LinkState::Up => (level::OK, "up", "answers"),
            LinkState::Refuses(problem) => (level::WARN, "refuses", problem),
            LinkState::Away(problem) => (level::ERROR, "away", problem),
        }
    }

    /// The text of `~/status`.
    pub fn json(&self) -> Value {
        let (_, state, message) = self.server();
        let frame = match &self.frame {
            FrameState::Ready { frame_id, stamp, age } => {
                json!({ "state": "ready", "frame_id": frame_id, "stamp": stamp, "age_s": age.as_secs_f64() })
            }
            FrameState::Unusable { reason, message } => {
                json!({ "state": "unusable", "reason": reason, "message": message })
            }
        };
        let goals: Vec<Value> = (self.goals.iter())
            .map(|g| json!({ "id": g.id, "hand": g.hand, "phase": g.phase, "elapsed_s": g.elapsed.as_secs_f64() }))
            .collect();
        let ended: serde_json::Map<_, _> =
            self.ended.iter().map(|(state, count)| ((*state).to_owned(), json!(count))).collect();
        json!({
            "node": self.node,
            "stopping": self.stopping,
            "server": { "url": self.server, "state": state, "message": message },
            "frame": frame,
            "images": self.images,
            "goals": goals,
            "ended": ended,
        })
    }

    /// The message on `/diagnostics`.
    pub fn diagnostics(&self, now: Stamp) -> DiagnosticArray {
        let status = |part: &str, level, message: &str, values: Vec<(&str, String)>| DiagnosticStatus {
            level,
            name: format!("{}: {part}", self.node.trim_start_matches('/')),
            message: message.to_owned(),
            hardware_id: self.server.clone(),
            values: values.into_iter().map(|(key, value)| KeyValue { key: key.to_owned(), value }).collect(),
        };
        let (severity, _, message) = self.server();
        let server = status("server", severity, message, vec![("url", self.server.clone())]);
        let images = ("images", self.images.to_string());
        let camera = match &self.frame {
            FrameState::Ready { frame_id, stamp, age } => status(
                "camera",
                level::OK,
                "a frame is ready",
                vec![
                    images,
                    ("frame_id", frame_id.clone()),
                    ("stamp", stamp.to_string()),
                    ("age_s", format!("{:.3}", age.as_secs_f64())),
                ],
            ),
            FrameState::Unusable { reason, message } => {
                let severity = if *reason == "INVALID_FRAME" { level::ERROR } else { level::WARN };
                status("camera", severity, message, vec![images, ("reason", (*reason).to_owned())])
            }
        };
        let mut values = vec![("running", self.goals.len().to_string())];
        values.extend(self.ended.iter().map(|(state, count)| (*state, count.to_string())));
        let message = if self.stopping { "stopping" } else { "takes goals" };
        let goals = status("goals", level::OK, message, values);
        let header = Header { stamp: now, frame_id: String::new() };
        DiagnosticArray { header, status: vec![server, camera, goals] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snapshot() -> Snapshot {
        let stamp = Stamp { sec: 1, nanosec: 5 };
        Snapshot {
            node: "/cell/graspd".into(),
            server: "http://127.0.0.1:1".into(),
            link: LinkState::Up,
            frame: FrameState::Ready { frame_id: "optical".into(), stamp, age: Duration::from_millis(250) },
            images: 3,
            goals: vec![GoalState {
                id: "a".into(),
                hand: "leap".into(),
                phase: "accepted",
                elapsed: Duration::from_secs(2),
            }],
            ended: vec![("succeeded", 4)],
            stopping: false,
        }
    }

    #[test]
    fn both_say_the_same() {
        let well = snapshot();
        let value = well.json();
        assert_eq!((&value["server"]["state"], &value["frame"]["age_s"]), (&json!("up"), &json!(0.25)));
        assert_eq!((&value["goals"][0]["id"], &value["ended"]["succeeded"]), (&json!("a"), &json!(4)));
        let told = well.diagnostics(Stamp::default());
        assert!(told.status.iter().all(|s| s.level == level::OK), "{told:?}");
        assert_eq!(told.status[0].name, "cell/graspd: server");
        assert_eq!(told.status[1].values[2], KeyValue { key: "stamp".into(), value: "1.000000005".into() });
    }

    #[test]
    fn what_is_wrong_is_told() {
        let frame = FrameState::Unusable { reason: "NO_FRAME", message: "no image".into() };
        let ill = Snapshot { link: LinkState::Away("nobody".into()), frame, ..snapshot() };
        let value = ill.json();
        assert_eq!(
            (&value["server"]["state"], &value["server"]["message"]),
            (&json!("away"), &json!("nobody"))
        );
        assert_eq!(value["frame"]["reason"], json!("NO_FRAME"));
        let told = ill.diagnostics(Stamp::default());
        assert_eq!((told.status[0].level, told.status[1].level), (level::ERROR, level::WARN));
        assert_eq!(told.status[0].message, "nobody");
        let refuses = Snapshot { link: LinkState::Refuses("who?".into()), ..snapshot() };
        assert_eq!(refuses.diagnostics(Stamp::default()).status[0].level, level::WARN);
    }
}

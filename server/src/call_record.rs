//! A call that is kept as it goes: for the recording, for the live view, or for both.

use std::sync::Arc;
use std::time::Duration;

use graspd_hands::Hand;
use graspd_proto::v1;
use graspd_proto::v1::hand_task_result::Outcome;
use graspd_proto::v1::plan_record::Request;
use prost::Message as _;

use crate::convert::duration_message;
use crate::deadline::CallClock;
use crate::engine::{Answer, Engine};
use crate::live;
use crate::recorder::{Place, timestamp, unix_time};
use crate::status;

/// A call that is being kept. Dropped without being finished, it is not.
#[derive(Debug)]
pub(crate) struct CallRecord {
    /// Its place in the recording; none if only the live view wants it.
    pub(crate) place: Option<Place>,
    clock: CallClock,
    /// When it came, nanoseconds since 1970.
    pub(crate) time_ns: u64,
    /// What was asked and answered so far.
    pub(crate) record: v1::PlanRecord,
    /// Hands of the answers.
    pub(crate) hands: Vec<Arc<Hand>>,
}

impl CallRecord {
    /// One task has ended.
    pub(crate) fn push(&mut self, task_id: &str, hand: Option<&Arc<Hand>>, answer: &Answer) {
        let outcome = match answer {
            Ok(response) => Outcome::Response(response.clone()),
            Err(error) => Outcome::Error(status::task_error(error)),
        };
        self.record.results.push(v1::HandTaskResult { task_id: task_id.to_owned(), outcome: Some(outcome) });
        if let Some(hand) = hand {
            self.hands.push(Arc::clone(hand));
        }
    }

    /// True if it goes into the recording.
    pub(crate) fn is_recorded(&self) -> bool {
        self.place.is_some()
    }
}

impl Engine {
    /// A call begins: it is kept if it is recorded, which it may ask for, or if there is a live view.
    pub(crate) fn begin_record(
        &self,
        asked: bool,
        clock: &CallClock,
        request: impl FnOnce() -> Request,
    ) -> Option<CallRecord> {
        let recorder = self.recorder.as_ref().filter(|recorder| recorder.wants(asked));
        if recorder.is_none() && self.live.is_none() {
            return None;
        }
        let request = request();
        let bytes = match &request {
            Request::PlanGrasps(plan) => plan.encoded_len(),
            Request::PlanMultiHand(plan) => plan.encoded_len(),
        };
        let place = recorder.and_then(|recorder| recorder.place(bytes));
        if place.is_none() && self.live.is_none() {
            return None;
        }
        let since: Duration = unix_time();
        let record = v1::PlanRecord {
            server_version: env!("CARGO_PKG_VERSION").to_owned(),
            receive_time: Some(timestamp(since)),
            request: Some(request),
            timeout: clock.timeout.map(duration_message),
            trace_id: clock.trace.id_text(),
            ..v1::PlanRecord::default()
        };
        let time_ns = u64::try_from(since.as_nanos()).unwrap_or(u64::MAX);
        Some(CallRecord { place, clock: *clock, time_ns, record, hands: Vec::new() })
    }

    /// A call has ended: shows it, and hands it to the thread that writes.
    pub(crate) fn end_record(&self, mut call: CallRecord) {
        call.record.total_duration = Some(duration_message(call.clock.elapsed()));
        let recorder = self.recorder.as_ref().filter(|_| call.is_recorded());
        if let Some(live) = &self.live {
            live.show(graspd_live::Layer::Plan, live::planned(&call));
        }
        if let Some(recorder) = recorder {
            recorder.finish(call);
        }
    }
}

//! What the live view shows of this server: the newest call, and the newest answer of a servo stream.

use std::sync::Arc;

use graspd_hands::Hand;
use graspd_live::Picture;
use graspd_proto::v1;
use graspd_recording::Bundle;

use crate::call_record::CallRecord;
use crate::convert::EncodedFrame;
use crate::picture;
use crate::recorder::unix_time;

/// A call that has ended.
#[derive(Debug)]
struct Planned {
    time_ns: u64,
    record: v1::PlanRecord,
    hands: Vec<Arc<Hand>>,
}

impl Picture for Planned {
    fn time_ns(&self) -> u64 {
        self.time_ns
    }

    fn draw(&self, bundle: &mut Bundle) {
        picture::draw_call(bundle, self.record.clone(), &self.hands);
    }
}

/// An answer of a servo stream, and the frame that it is about.
#[derive(Debug)]
struct Followed {
    time_ns: u64,
    frame: EncodedFrame,
    answer: v1::ServoGraspResponse,
    hand: Arc<Hand>,
}

impl Picture for Followed {
    fn time_ns(&self) -> u64 {
        self.time_ns
    }

    fn draw(&self, bundle: &mut Bundle) {
        picture::draw_servo(bundle, &self.frame, &self.answer, &self.hand);
    }
}

/// The picture of a call.
pub(crate) fn planned(call: &CallRecord) -> Arc<dyn Picture> {
    // The pixels are shared, not copied.
    let CallRecord { time_ns, record, hands, .. } = call;
    Arc::new(Planned { time_ns: *time_ns, record: record.clone(), hands: hands.clone() })
}

/// The picture of a servo stream's answer, of now.
pub(crate) fn followed(
    frame: EncodedFrame,
    answer: v1::ServoGraspResponse,
    hand: &Arc<Hand>,
) -> Arc<dyn Picture> {
    let time_ns = u64::try_from(unix_time().as_nanos()).unwrap_or(u64::MAX);
    Arc::new(Followed { time_ns, frame, answer, hand: Arc::clone(hand) })
}

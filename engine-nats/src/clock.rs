//! How the broker's clock differs from this machine's: ages of jobs and ends of leases are counted on the broker's.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::connection::Broker;
use crate::presence::WorkerCard;

/// The broker's clock minus this machine's, microseconds: off by half a round trip at most. Says on the way, as `name`,
/// who this process is.
pub(crate) async fn offset_us(broker: &Broker, name: &str, card: &WorkerCard) -> Result<i64, String> {
    let bucket = broker.jetstream.get_key_value(broker.names.workers()).await.map_err(|e| e.to_string())?;
    let (began, wall) = (Instant::now(), SystemTime::now());
    bucket.put(name, card.bytes().into()).await.map_err(|e| e.to_string())?;
    let round_trip = began.elapsed();
    let entry = bucket.entry(name).await.map_err(|e| e.to_string())?.ok_or("the entry is gone")?;
    // The broker wrote it half way between.
    let theirs = micros(entry.created.unix_timestamp_nanos());
    Ok(theirs.saturating_sub(now_us(wall + round_trip / 2)))
}

/// How long ago the broker's clock showed this time, nanoseconds since 1970; never negative.
pub(crate) fn age(shown_ns: i128, offset_us: i64) -> Duration {
    let age = now_us(SystemTime::now()).saturating_add(offset_us).saturating_sub(micros(shown_ns));
    Duration::from_micros(u64::try_from(age).unwrap_or(0))
}

fn micros(nanos: i128) -> i64 {
    i64::try_from(nanos / 1000).unwrap_or(i64::MAX)
}

fn now_us(time: SystemTime) -> i64 {
    let since = time.duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_micros()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_age_is_counted_on_the_brokers_clock_and_never_negative() {
        let now_ns = i128::from(now_us(SystemTime::now())) * 1000;
        let hour_us = 3_600_000_000;
        // The broker is an hour ahead: what it wrote at its time five seconds ago is five seconds old.
        let written = now_ns + i128::from(hour_us - 5_000_000) * 1000;
        let seconds = age(written, hour_us).as_secs_f64();
        assert!((5.0..60.0).contains(&seconds), "{seconds}");
        assert_eq!(age(now_ns + 10_000_000_000_000, 0), Duration::ZERO);
    }
}

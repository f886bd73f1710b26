//! Which image, camera info and labels belong together: those of one exposure, which is one stamp.
//!
//! Messages of three topics come in any order, and any of them may be lost. A few of each are kept; whenever one completes an exposure,
//! that is the newest frame unless a newer one was complete before. The newest frame alone is of use: older ones are dropped.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::messages::{CameraInfo, Image, Stamp};

/// Messages of each topic that wait for their partners.
const KEPT: usize = 8;
/// How far messages are overtaken at most.
const OVERTAKEN: Duration = Duration::from_secs(1);

/// What is matched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PairingRules {
    /// A frame needs a label image.
    pub labels: bool,
    /// Stamps may differ by this much. 0: they are equal, as drivers send them.
    pub tolerance: Duration,
    /// Any camera info will do: a lens that never changes, sent once.
    pub any_info: bool,
}

/// One exposure.
#[derive(Debug, Clone)]
pub struct Exposure {
    /// Depth.
    pub image: Arc<Image>,
    /// The lens.
    pub info: Arc<CameraInfo>,
    /// Labels, where they are asked for.
    pub labels: Option<Arc<Image>>,
    /// When it was complete here.
    pub complete: Instant,
}

/// Why there is no frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Missing {
    /// No depth image has come.
    Image,
    /// No camera info has come.
    Info,
    /// No label image has come.
    Labels,
    /// All have come, and no stamps agree; the nearest are so far apart.
    Match {
        /// What has no partner of its stamp.
        partner: &'static str,
        /// The smallest difference.
        nearest: Duration,
    },
}

/// Puts exposures together.
#[derive(Debug, Default)]
pub struct Pairing {
    rules: PairingRules,
    images: VecDeque<Arc<Image>>,
    infos: VecDeque<Arc<CameraInfo>>,
    labels: VecDeque<Arc<Image>>,
    newest: Option<Exposure>,
    /// Images that have come.
    image_count: u64,
}

impl Pairing {
    /// With these rules.
    pub fn new(rules: PairingRules) -> Self {
        Self { rules, ..Self::default() }
    }

    /// A depth image has come.
    pub fn image(&mut self, image: Image, now: Instant) {
        self.image_count += 1;
        keep(&mut self.images, image, |i| i.header.stamp);
        self.complete(now);
    }

    /// A camera info has come.
    pub fn info(&mut self, info: CameraInfo, now: Instant) {
        keep(&mut self.infos, info, |i| i.header.stamp);
        self.complete(now);
    }

    /// A label image has come.
    pub fn labels(&mut self, labels: Image, now: Instant) {
        keep(&mut self.labels, labels, |i| i.header.stamp);
        self.complete(now);
    }

    /// The newest exposure that is complete.
    ///
    /// # Errors
    /// What there is none for.
    pub fn newest(&self) -> Result<&Exposure, Missing> {
        self.newest.as_ref().ok_or_else(|| self.missing())
    }

    /// Depth images that have come.
    pub fn image_count(&self) -> u64 {
        self.image_count
    }

    fn missing(&self) -> Missing {
        let Some(image) = self.images.back() else { return Missing::Image };
        if self.infos.is_empty() {
            return Missing::Info;
        }
        if self.rules.labels && self.labels.is_empty() {
            return Missing::Labels;
        }
        let stamp = image.header.stamp;
        let nearest = |stamps: &mut dyn Iterator<Item = Stamp>| stamps.map(|s| s.distance(stamp)).min();
        let info = nearest(&mut self.infos.iter().map(|i| i.header.stamp)).unwrap_or_default();
        if !self.rules.any_info && info > self.rules.tolerance {
            return Missing::Match { partner: "camera info", nearest: info };
        }
        let labels = nearest(&mut self.labels.iter().map(|i| i.header.stamp)).unwrap_or_default();
        Missing::Match { partner: "label image", nearest: labels }
    }

    /// Takes the newest image that has its partners.
    fn complete(&mut self, now: Instant) {
        let found = self.images.iter().enumerate().rev().find_map(|(index, image)| {
            let stamp = image.header.stamp;
            let info = match partner(&self.infos, stamp, self.rules.tolerance, |i| i.header.stamp) {
                None if self.rules.any_info => self.infos.back(),
                found => found,
            }?;
            let labels = match self.rules.labels {
                true => Some(partner(&self.labels, stamp, self.rules.tolerance, |i| i.header.stamp)?),
                false => None,
            };
            let (image, info, labels) = (Arc::clone(image), Arc::clone(info), labels.map(Arc::clone));
            Some((index, Exposure { image, info, labels, complete: now }))
        });
        if let Some((index, exposure)) = found {
            // Older ones will never be asked for. Infos and labels may still be somebody's.
            self.images.drain(..=index);
            let stamp = exposure.image.header.stamp;
            let late = self.newest.as_ref().is_some_and(|n| is_late(stamp, n.image.header.stamp));
            if !late {
                self.newest = Some(exposure);
            }
        }
    }
}

/// Older, but by so little that it has been overtaken; more, and a recording was started again.
fn is_late(stamp: Stamp, last: Stamp) -> bool {
    stamp < last && stamp.distance(last) <= OVERTAKEN
}

/// Adds a message as the latest, or as the first where a recording was started again.
fn keep<T>(kept: &mut VecDeque<Arc<T>>, message: T, stamp: impl Fn(&T) -> Stamp) {
    let began_again = kept
        .back()
        .is_some_and(|last| stamp(&message) < stamp(last) && !is_late(stamp(&message), stamp(last)));
    if began_again {
        kept.clear();
    }
    kept.push_back(Arc::new(message));
    while kept.len() > KEPT {
        kept.pop_front();
    }
}

/// The message nearest to a stamp, if it is within the tolerance.
fn partner<T>(
    kept: &VecDeque<Arc<T>>,
    at: Stamp,
    tolerance: Duration,
    stamp: impl Fn(&T) -> Stamp,
) -> Option<&Arc<T>> {
    kept.iter().min_by_key(|m| stamp(m).distance(at)).filter(|m| stamp(m).distance(at) <= tolerance)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::messages::Header;

    fn at(ms: u32) -> Header {
        Header {
            stamp: Stamp { sec: (ms / 1000) as i32, nanosec: ms % 1000 * 1_000_000 },
            ..Header::default()
        }
    }

    fn image(ms: u32) -> Image {
        Image { header: at(ms), ..Image::default() }
    }

    fn info(ms: u32) -> CameraInfo {
        CameraInfo { header: at(ms), ..CameraInfo::default() }
    }

    fn stamps(pairing: &Pairing) -> Option<(Stamp, Stamp)> {
        pairing.newest().ok().map(|e| (e.image.header.stamp, e.info.header.stamp))
    }

    proptest! {
        /// Whatever is lost and in whatever order the rest comes: what is paired is of one stamp, and never gets older.
        #[test]
        fn pairs_are_of_one_stamp_and_never_older(
            messages in proptest::collection::vec((0u32..12, any::<bool>()), 0..60),
        ) {
            let mut pairing = Pairing::default();
            let (mut sent, mut last) = ([vec![], vec![]], None);
            for (ms, is_image) in messages {
                sent[usize::from(is_image)].push(ms);
                if is_image {
                    pairing.image(image(ms), Instant::now());
                } else {
                    pairing.info(info(ms), Instant::now());
                }
                if let Some((image, info)) = stamps(&pairing) {
                    prop_assert_eq!(image, info);
                    prop_assert!(last <= Some(image), "{last:?} {image:?}");
                    last = Some(image);
                }
            }
            // Few enough messages are all kept: a stamp that both have is found.
            if sent.iter().all(|s| s.len() <= KEPT) {
                let both = sent[0].iter().filter(|ms| sent[1].contains(ms)).max();
                prop_assert_eq!(both.is_some(), last.is_some());
            }
        }
    }

    #[test]
    fn the_newest_complete_exposure_counts() {
        let (mut pairing, now) = (Pairing::default(), Instant::now());
        assert_eq!(pairing.newest().unwrap_err(), Missing::Image);
        pairing.image(image(10), now);
        assert_eq!(pairing.newest().unwrap_err(), Missing::Info);
        pairing.info(info(13), now);
        let nearest = Duration::from_millis(3);
        assert_eq!(pairing.newest().unwrap_err(), Missing::Match { partner: "camera info", nearest });
        pairing.image(image(20), now);
        pairing.info(info(20), now);
        assert_eq!(stamps(&pairing).unwrap().0, at(20).stamp);
        // An image whose camera info has not come yet does not replace it.
        pairing.image(image(30), now);
        assert_eq!(stamps(&pairing).unwrap().0, at(20).stamp);
        pairing.info(info(30), now);
        assert_eq!(stamps(&pairing).unwrap().0, at(30).stamp);
        assert_eq!(pairing.image_count(), 3);
        // A camera info that comes first waits for its image.
        pairing.info(info(40), now);
        pairing.image(image(40), now);
        assert_eq!(stamps(&pairing).unwrap().0, at(40).stamp);
    }

    #[test]
    fn rules_are_kept_to() {
        let now = Instant::now();
        let tolerance = Duration::from_millis(5);
        let mut near = Pairing::new(PairingRules { tolerance, ..PairingRules::default() });
        near.info(info(100), now);
        near.info(info(104), now);
        near.image(image(103), now);
        assert_eq!(stamps(&near).unwrap(), (at(103).stamp, at(104).stamp));
        let mut once = Pairing::new(PairingRules { any_info: true, ..PairingRules::default() });
        once.info(info(0), now);
        once.image(image(900), now);
        assert_eq!(stamps(&once).unwrap(), (at(900).stamp, at(0).stamp));
        let mut labelled = Pairing::new(PairingRules { labels: true, ..PairingRules::default() });
        labelled.info(info(7), now);
        labelled.image(image(7), now);
        assert_eq!(labelled.newest().unwrap_err(), Missing::Labels);
        labelled.labels(image(8), now);
        let nearest = Duration::from_millis(1);
        assert_eq!(labelled.newest().unwrap_err(), Missing::Match { partner: "label image", nearest });
        labelled.labels(image(7), now);
        assert_eq!(labelled.newest().unwrap().labels.as_ref().unwrap().header.stamp, at(7).stamp);
    }

    #[test]
    fn a_recording_may_begin_again() {
        let (mut pairing, now) = (Pairing::default(), Instant::now());
        for ms in [5000, 5033] {
            pairing.image(image(ms), now);
            pairing.info(info(ms), now);
        }
        pairing.image(image(100), now);
        pairing.info(info(100), now);
        assert_eq!(stamps(&pairing).unwrap().0, at(100).stamp);
    }
}

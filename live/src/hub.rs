//! The hub: one task that knows the newest pictures, the channels and the viewers, and sends each what it wants.
//!
//! Channels are the topics of the newest pictures: one that the next plan has not is gone with it, and so is what viewers
//! had drawn of it. Nothing is drawn while nobody is connected, and no message is encoded that nobody has subscribed
//! to; what was encoded is kept for those who come later, until there is a newer picture.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bytes::Bytes;
use graspd_recording::{Bundle, Schema};
use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::counts::{Counters, add};
use crate::news::{News, Waiting};
use crate::outbox::Outbox;
use crate::protocol::{self, Channel, Level, Request};
use crate::{Layer, Picture};

/// Pictures that are drawn in a second at most: enough for eyes, and a bound on what viewers cost.
pub const PICTURES_PER_SECOND: u32 = 20;

/// What connections tell the hub.
#[derive(Debug)]
pub(crate) enum Event {
    Arrived(u64, Arc<Outbox>),
    Asked(u64, Request),
    Left(u64),
}

/// The newest picture of a layer, and what was drawn of it.
#[derive(Debug, Default)]
struct Shown {
    picture: Option<Arc<dyn Picture>>,
    /// False until its topics are known.
    is_outlined: bool,
    topics: Vec<(String, Schema)>,
    /// By topic; those that somebody wanted.
    encoded: HashMap<String, Vec<Bytes>>,
}

#[derive(Debug)]
struct Client {
    outbox: Arc<Outbox>,
    /// Channels by the viewer's own numbers.
    subscriptions: BTreeMap<u32, u32>,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Hub {
    news: Arc<News>,
    counters: Arc<Counters>,
    layers: [Shown; Layer::ALL.len()],
    /// By topic.
    channels: BTreeMap<String, Channel>,
    next_channel: u32,
    clients: HashMap<u64, Client>,
}

impl Hub {
    pub(crate) fn new(news: Arc<News>, counters: Arc<Counters>) -> Self {
        Self {
            news,
            counters,
            layers: Default::default(),
            channels: BTreeMap::new(),
            next_channel: 1,
            clients: HashMap::new(),
        }
    }

    /// Until nobody can tell it anything any more.
    pub(crate) async fn run(mut self, mut events: mpsc::Receiver<Event>) {
        let pause = Duration::from_secs(1) / PICTURES_PER_SECOND;
        let mut earliest = Instant::now();
        let news = Arc::clone(&self.news);
        loop {
            let newest = async {
                tokio::time::sleep_until(earliest).await;
                news.take().await
            };
            tokio::select! {
                event = events.recv() => match event {
                    None => return,
                    Some(Event::Arrived(id, outbox)) => self.arrived(id, outbox).await,
                    Some(Event::Asked(id, request)) => self.asked(id, request).await,
                    Some(Event::Left(id)) => {
                        self.clients.remove(&id);
                        self.count_clients();
                    }
                },
                newest = newest => {
                    self.show_all(newest).await;
                    if !self.clients.is_empty() {
                        earliest = Instant::now() + pause;
                    }
                }
            }
        }
    }

    fn count_clients(&self) {
        self.counters.clients.store(self.clients.len() as u64, Ordering::Relaxed);
    }

    async fn show_all(&mut self, newest: Waiting) {
        for (layer, picture) in Layer::ALL.into_iter().zip(newest) {
            if let Some(picture) = picture {
                self.show(layer, picture).await;
            }
        }
    }

    /// There is a newer picture.
    async fn show(&mut self, layer: Layer, picture: Arc<dyn Picture>) {
        self.layers[layer.index()] = Shown { picture: Some(picture), ..Shown::default() };
        if self.clients.is_empty() {
            return;
        }
        let subscribed = self.clients.values().flat_map(|client| client.subscriptions.values());
        let wanted = self.topics(subscribed);
        self.draw(layer, wanted).await;
        self.tell_channels();
        for client in self.clients.values() {
            self.send(client, layer, client.subscriptions.keys());
        }
    }

    async fn arrived(&mut self, id: u64, outbox: Arc<Outbox>) {
        if self.clients.is_empty() {
            // Whoever has handed in a picture before knows that it is seen.
            let newest = self.news.take_now();
            self.show_all(newest).await;
            for layer in Layer::ALL {
                self.draw(layer, BTreeSet::new()).await;
            }
            // Nobody is there yet who would have to be told.
            self.tell_channels();
        }
        outbox.say(protocol::advertise(self.channels.values()));
        self.clients.insert(id, Client { outbox, subscriptions: BTreeMap::new() });
        self.count_clients();
    }

    async fn asked(&mut self, id: u64, request: Request) {
        let Some(client) = self.clients.get_mut(&id) else { return };
        let pairs = match request {
            Request::Unsubscribe(subscriptions) => {
                for subscription in subscriptions {
                    client.subscriptions.remove(&subscription);
                    client.outbox.forget(subscription);
                }
                return;
            }
            Request::Subscribe(pairs) => pairs,
        };
        let mut new = Vec::new();
        for (subscription, channel) in pairs {
            let fault = if !self.channels.values().any(|known| known.id == channel) {
                Some(format!("subscription {subscription}: there is no channel {channel}"))
            } else if client.subscriptions.contains_key(&subscription) {
                Some(format!("subscription {subscription}: this number is in use"))
            } else if client.subscriptions.values().any(|c| *c == channel) {
                Some(format!("subscription {subscription}: channel {channel} has one already"))
            } else {
                None
            };
            match fault {
                // A channel can be gone by the time that somebody asks for it.
                Some(fault) => client.outbox.say(protocol::status(Level::Warning, &fault)),
                None => {
                    client.subscriptions.insert(subscription, channel);
                    new.push((subscription, channel));
                }
            }
        }
        let wanted = self.topics(new.iter().map(|(_, channel)| channel));
        for layer in Layer::ALL {
            self.draw(layer, wanted.clone()).await;
        }
        if let Some(client) = self.clients.get(&id) {
            for layer in Layer::ALL {
                self.send(client, layer, new.iter().map(|(subscription, _)| subscription));
            }
        }
    }

    /// The topics of channels.
    fn topics<'a>(&self, channels: impl Iterator<Item = &'a u32>) -> BTreeSet<String> {
        let wanted: BTreeSet<u32> = channels.copied().collect();
        let of = self.channels.values().filter(|channel| wanted.contains(&channel.id));
        of.map(|channel| channel.topic.clone()).collect()
    }

    /// Draws the topics of these that are not drawn yet, off the runtime's threads.
    async fn draw(&mut self, layer: Layer, mut wanted: BTreeSet<String>) {
        let shown = &mut self.layers[layer.index()];
        let Some(picture) = shown.picture.clone() else { return };
        wanted.retain(|topic| !shown.encoded.contains_key(topic));
        if shown.is_outlined {
            wanted.retain(|topic| shown.topics.iter().any(|(known, _)| known == topic));
            if wanted.is_empty() {
                return;
            }
        }
        let asked = wanted.clone();
        let drawn = tokio::task::spawn_blocking(move || {
            let mut bundle = Bundle::only(picture.time_ns(), wanted);
            picture.draw(&mut bundle);
            bundle
        });
        let bundle = match drawn.await {
            Ok(bundle) => bundle,
            Err(error) => {
                tracing::error!(%error, "a picture cannot be drawn");
                self.layers[layer.index()] = Shown::default();
                return;
            }
        };
        if !asked.is_empty() {
            add(&self.counters.drawn, 1);
        }
        shown.is_outlined = true;
        shown.topics = bundle.offered().to_vec();
        // Those without a message too: there is nothing to draw again.
        shown.encoded.extend(asked.into_iter().map(|topic| (topic, Vec::new())));
        for message in bundle.messages {
            shown.encoded.entry(message.topic).or_default().push(message.data.into());
        }
    }

    /// Makes the channels those of the newest pictures, and tells everybody what is different.
    fn tell_channels(&mut self) {
        let topics = self.layers.iter().flat_map(|shown| &shown.topics);
        let now: BTreeMap<String, Schema> = topics.cloned().collect();
        let mut gone = Vec::new();
        self.channels.retain(|topic, channel| {
            let stays = now.get(topic) == Some(&channel.schema);
            if !stays {
                gone.push(channel.id);
            }
            stays
        });
        let mut come = Vec::new();
        for (topic, schema) in now {
            if !self.channels.contains_key(&topic) {
                let channel = Channel { id: self.next_channel, topic: topic.clone(), schema };
                // Numbers are not used again: viewers remember schemas by them.
                self.next_channel = self.next_channel.wrapping_add(1);
                come.push(channel.clone());
                self.channels.insert(topic, channel);
            }
        }
        for client in self.clients.values_mut() {
            client.subscriptions.retain(|subscription, channel| {
                let stays = !gone.contains(channel);
                if !stays {
                    client.outbox.forget(*subscription);
                }
                stays
            });
            if !gone.is_empty() {
                client.outbox.say(protocol::unadvertise(&gone));
            }
            if !come.is_empty() {
                client.outbox.say(protocol::advertise(&come));
            }
        }
    }

    /// Sends what was drawn of a layer to these subscriptions of a viewer.
    fn send<'a>(&self, client: &Client, layer: Layer, subscriptions: impl Iterator<Item = &'a u32>) {
        let shown = &self.layers[layer.index()];
        let Some(picture) = &shown.picture else { return };
        for subscription in subscriptions {
            let Some(channel) = client.subscriptions.get(subscription) else { continue };
            let Some(channel) = self.channels.values().find(|known| known.id == *channel) else { continue };
            match shown.encoded.get(&channel.topic) {
                Some(messages) if !messages.is_empty() => {
                    client.outbox.put(*subscription, layer, picture.time_ns(), messages);
                }
                _ => {}
            }
        }
    }
}

//! Executes commands with a Zenoh session.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Queryable, Reply};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt, AdvancedSubscriber,
    AdvancedSubscriberBuilderExt, CacheConfig, HistoryConfig, MissDetectionConfig, RecoveryConfig,
};

pub type Any = Box<dyn std::error::Error + Send + Sync>;

/// The maximum number of pending requests of a service; further requests are rejected.
const MAX_PENDING: usize = 1_000;

type PendingQueries = Arc<Mutex<HashMap<u32, Query>>>;

enum Declared {
    Publisher(Publisher<'static>),
    CachedPublisher(Box<AdvancedPublisher<'static>>),
    Subscriber(#[allow(dead_code)] Subscriber<()>),
    LateSubscriber(#[allow(dead_code)] AdvancedSubscriber<()>),
    Token(#[allow(dead_code)] LivelinessToken),
    Service(Queryable<()>, PendingQueries),
}

/// Takes a number of four bytes, and returns it and the rest.
fn take_number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let number = u32::from_be_bytes(bytes.get(..4)?.try_into().ok()?);
    Some((number, bytes.get(4..)?))
}

/// Takes a part that is preceded by its length, and returns it and the rest.
fn take_part(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let size = usize::from(u16::from_be_bytes(bytes.get(..2)?.try_into().ok()?));
    Some((bytes.get(2..2 + size)?, bytes.get(2 + size..)?))
}

fn parse_text(bytes: &[u8]) -> Result<String, Any> {
    Ok(String::from_utf8(bytes.to_vec())?)
}

fn build_frame(kind: u8, id: u32, parts: &[&[u8]]) -> Vec<u8> {
    let mut out = vec![kind];
    out.extend(id.to_be_bytes());
    for part in parts {
        out.extend(*part);
    }
    out
}

fn prefix_length(bytes: &[u8]) -> Vec<u8> {
    let size = u16::try_from(bytes.len()).unwrap_or(u16::MAX);
    [&size.to_be_bytes(), &bytes[..usize::from(size)]].concat()
}

fn encode_attachment(attachment: Option<&ZBytes>) -> Vec<u8> {
    prefix_length(&attachment.map(ZBytes::to_bytes).unwrap_or_default())
}

fn sample_frame(id: u32, sample: &Sample) -> Vec<u8> {
    let key = prefix_length(sample.key_expr().as_str().as_bytes());
    let attachment = encode_attachment(sample.attachment());
    build_frame(2, id, &[&key, &attachment, &sample.payload().to_bytes()])
}

fn token_frame(id: u32, sample: &Sample) -> Vec<u8> {
    let alive = u8::from(sample.kind() == SampleKind::Put);
    build_frame(3, id, &[&[alive], sample.key_expr().as_str().as_bytes()])
}

fn reply_frame(id: u32, reply: &Reply) -> Vec<u8> {
    match reply.result() {
        Ok(sample) => {
            let attachment = encode_attachment(sample.attachment());
            build_frame(6, id, &[&attachment, &sample.payload().to_bytes()])
        }
        Err(why) => build_frame(7, id, &[&why.payload().to_bytes()]),
    }
}

/// A request in flight. When it is dropped, an event reports that no more replies will follow.
struct PendingRequest(u32, Sender<Vec<u8>>);

impl PendingRequest {
    fn forward_reply(&self, reply: &Reply) {
        drop(self.1.send(reply_frame(self.0, reply)));
    }
}

impl Drop for PendingRequest {
    fn drop(&mut self) {
        drop(self.1.send(build_frame(8, self.0, &[])));
    }
}

pub struct Port {
    session: Session,
    declared: HashMap<u32, Declared>,
    out: Sender<Vec<u8>>,
}

impl Port {
    pub fn new(session: Session, out: Sender<Vec<u8>>) -> Self {
        let declared = HashMap::new();
        Port {
            session,
            declared,
            out,
        }
    }

    /// Executes the command in a frame. An error is reported as an event.
    pub fn handle_frame(&mut self, bytes: &[u8]) -> Result<(), Any> {
        let (command, rest) = bytes.split_first().ok_or("the frame is empty")?;
        let (id, rest) = take_number(rest).ok_or("the frame has no id")?;
        if let Err(why) = self.execute_command(*command, id, rest) {
            self.out
                .send(build_frame(255, id, &[why.to_string().as_bytes()]))?;
        }
        Ok(())
    }

    pub fn close(mut self) -> Result<(), Any> {
        self.declared.clear();
        self.session.close().wait()
    }

    fn execute_command(&mut self, command: u8, id: u32, rest: &[u8]) -> Result<(), Any> {
        let out = self.out.clone();
        let new = match command {
            1 => {
                let publisher = self.session.declare_publisher(parse_text(rest)?);
                let publisher = publisher.congestion_control(CongestionControl::Block);
                Declared::Publisher(publisher.wait()?)
            }
            2 => return self.put_sample(id, rest),
            3 => {
                let subscriber = self.session.declare_subscriber(parse_text(rest)?);
                let forward = move |s: Sample| drop(out.send(sample_frame(id, &s)));
                Declared::Subscriber(subscriber.callback(forward).wait()?)
            }
            4 => {
                let token = self.session.liveliness().declare_token(parse_text(rest)?);
                Declared::Token(token.wait()?)
            }
            5 => {
                self.declared.remove(&id);
                return Ok(());
            }
            6 => {
                let liveliness = self.session.liveliness();
                let subscriber = liveliness
                    .declare_subscriber(parse_text(rest)?)
                    .history(true);
                let forward = move |s: Sample| drop(out.send(token_frame(id, &s)));
                Declared::Subscriber(subscriber.callback(forward).wait()?)
            }
            7 => self.declare_cached_publisher(rest)?,
            8 => self.declare_late_subscriber(id, rest)?,
            9 => self.declare_service(id, rest)?,
            10 => return self.send_request(id, rest),
            11 | 12 => return self.answer_request(command == 11, id, rest),
            _ => return Err("no such command".into()),
        };
        self.declared.insert(id, new);
        Ok(())
    }

    fn put_sample(&mut self, id: u32, rest: &[u8]) -> Result<(), Any> {
        let (attachment, payload) = take_part(rest).ok_or("the put is truncated")?;
        match self.declared.get(&id) {
            Some(Declared::Publisher(publisher)) => {
                publisher.put(payload).attachment(attachment).wait()?;
            }
            Some(Declared::CachedPublisher(publisher)) => {
                publisher.put(payload).attachment(attachment).wait()?;
            }
            _ => return Err("no such publisher".into()),
        }
        drop(self.out.send(build_frame(4, id, &[])));
        Ok(())
    }

    /// Declares a publisher that keeps its last samples, like `rmw_zenoh` with durability TRANSIENT_LOCAL and
    /// reliability RELIABLE.
    fn declare_cached_publisher(&mut self, rest: &[u8]) -> Result<Declared, Any> {
        let (depth, key) = take_number(rest).ok_or("the publisher is truncated")?;
        let publisher = self.session.declare_publisher(parse_text(key)?);
        let publisher = publisher
            .congestion_control(CongestionControl::Block)
            .cache(CacheConfig::default().max_samples(depth as usize))
            .publisher_detection()
            .sample_miss_detection(MissDetectionConfig::default());
        Ok(Declared::CachedPublisher(Box::new(publisher.wait()?)))
    }

    fn declare_late_subscriber(&mut self, id: u32, rest: &[u8]) -> Result<Declared, Any> {
        let (depth, key) = take_number(rest).ok_or("the subscriber is truncated")?;
        let out = self.out.clone();
        let history = HistoryConfig::default()
            .detect_late_publishers()
            .max_samples(depth as usize);
        let subscriber = self.session.declare_subscriber(parse_text(key)?);
        let subscriber = subscriber
            .callback(move |s: Sample| drop(out.send(sample_frame(id, &s))))
            .history(history)
            .recovery(RecoveryConfig::default().heartbeat())
            .subscriber_detection();
        Ok(Declared::LateSubscriber(subscriber.wait()?))
    }

    fn declare_service(&mut self, id: u32, rest: &[u8]) -> Result<Declared, Any> {
        let (out, next) = (self.out.clone(), AtomicU32::new(0));
        let waiting = PendingQueries::default();
        let held = waiting.clone();
        let receive = move |query: Query| {
            let request = next.fetch_add(1, Ordering::Relaxed);
            let payload = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
            let attachment = encode_attachment(query.attachment());
            let frame = build_frame(5, id, &[&request.to_be_bytes(), &attachment, &payload]);
            drop(payload);
            let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
            if held.len() < MAX_PENDING {
                held.insert(request, query);
                drop(out.send(frame));
            } else {
                drop(query.reply_err("too many pending requests").wait());
            }
        };
        let service = self.session.declare_queryable(parse_text(rest)?);
        let service = service.complete(true).callback(receive).wait()?;
        Ok(Declared::Service(service, waiting))
    }

    fn answer_request(&mut self, accepted: bool, id: u32, rest: &[u8]) -> Result<(), Any> {
        let (request, rest) = take_number(rest).ok_or("the reply is truncated")?;
        let Some(Declared::Service(service, waiting)) = self.declared.get(&id) else {
            return Err("no such service".into());
        };
        let query = {
            let mut waiting = waiting.lock().unwrap_or_else(PoisonError::into_inner);
            waiting.remove(&request).ok_or("no such request")?
        };
        if accepted {
            let (attachment, payload) = take_part(rest).ok_or("the reply is truncated")?;
            let reply = query.reply(service.key_expr(), payload);
            reply.attachment(attachment).wait()
        } else {
            query.reply_err(rest).wait()
        }
    }

    fn send_request(&mut self, id: u32, rest: &[u8]) -> Result<(), Any> {
        let truncated = "the request is truncated";
        let (ms, rest) = take_number(rest).ok_or(truncated)?;
        let (key, rest) = take_part(rest).ok_or(truncated)?;
        let (attachment, payload) = take_part(rest).ok_or(truncated)?;
        let pending = PendingRequest(id, self.out.clone());
        let forward = move |reply: Reply| pending.forward_reply(&reply);
        self.session
            .get(parse_text(key)?)
            .payload(payload)
            .attachment(attachment)
            .target(QueryTarget::AllComplete)
            .consolidation(ConsolidationMode::None)
            .timeout(Duration::from_millis(u64::from(ms)))
            .callback(forward)
            .wait()
    }
}

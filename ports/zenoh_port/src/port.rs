//! Does with the session as it is told.

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

/// Requests of one service that wait for an answer; those beyond are refused.
const MOST_WAITING: usize = 1_000;

type Waiting = Arc<Mutex<HashMap<u32, Query>>>;

enum Declared {
    Publisher(Publisher<'static>),
    Keeper(Box<AdvancedPublisher<'static>>),
    Subscriber(#[allow(dead_code)] Subscriber<()>),
    LateSubscriber(#[allow(dead_code)] AdvancedSubscriber<()>),
    Token(#[allow(dead_code)] LivelinessToken),
    Service(Queryable<()>, Waiting),
}

/// A number of four bytes, and what follows.
fn number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let number = u32::from_be_bytes(bytes.get(..4)?.try_into().ok()?);
    Some((number, bytes.get(4..)?))
}

/// A part that has its length before it, and what follows.
fn part(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let size = usize::from(u16::from_be_bytes(bytes.get(..2)?.try_into().ok()?));
    Some((bytes.get(2..2 + size)?, bytes.get(2 + size..)?))
}

fn text(bytes: &[u8]) -> Result<String, Any> {
    Ok(String::from_utf8(bytes.to_vec())?)
}

fn said(what: u8, id: u32, parts: &[&[u8]]) -> Vec<u8> {
    let mut out = vec![what];
    out.extend(id.to_be_bytes());
    for part in parts {
        out.extend(*part);
    }
    out
}

fn sized(bytes: &[u8]) -> Vec<u8> {
    let size = u16::try_from(bytes.len()).unwrap_or(u16::MAX);
    [&size.to_be_bytes(), &bytes[..usize::from(size)]].concat()
}

fn attached(attachment: Option<&ZBytes>) -> Vec<u8> {
    sized(&attachment.map(ZBytes::to_bytes).unwrap_or_default())
}

fn sample(id: u32, sample: &Sample) -> Vec<u8> {
    let key = sized(sample.key_expr().as_str().as_bytes());
    let attachment = attached(sample.attachment());
    said(2, id, &[&key, &attachment, &sample.payload().to_bytes()])
}

fn token(id: u32, sample: &Sample) -> Vec<u8> {
    let alive = u8::from(sample.kind() == SampleKind::Put);
    said(3, id, &[&[alive], sample.key_expr().as_str().as_bytes()])
}

fn answer(id: u32, reply: &Reply) -> Vec<u8> {
    match reply.result() {
        Ok(sample) => {
            let attachment = attached(sample.attachment());
            said(6, id, &[&attachment, &sample.payload().to_bytes()])
        }
        Err(why) => said(7, id, &[&why.payload().to_bytes()]),
    }
}

/// A request that was sent; it says, when it is dropped, that nobody answers any more.
struct Asked(u32, Sender<Vec<u8>>);

impl Asked {
    fn hear(&self, reply: &Reply) {
        drop(self.1.send(answer(self.0, reply)));
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        drop(self.1.send(said(8, self.0, &[])));
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

    /// One frame: what it tells to do is done, or trouble is told.
    pub fn hear(&mut self, bytes: &[u8]) -> Result<(), Any> {
        let (what, rest) = bytes.split_first().ok_or("an empty frame")?;
        let (id, rest) = number(rest).ok_or("a frame without an id")?;
        if let Err(why) = self.obey(*what, id, rest) {
            self.out
                .send(said(255, id, &[why.to_string().as_bytes()]))?;
        }
        Ok(())
    }

    pub fn end(mut self) -> Result<(), Any> {
        self.declared.clear();
        self.session.close().wait()
    }

    fn obey(&mut self, what: u8, id: u32, rest: &[u8]) -> Result<(), Any> {
        let out = self.out.clone();
        let new = match what {
            1 => {
                let publisher = self.session.declare_publisher(text(rest)?);
                let publisher = publisher.congestion_control(CongestionControl::Block);
                Declared::Publisher(publisher.wait()?)
            }
            2 => return self.put(id, rest),
            3 => {
                let subscriber = self.session.declare_subscriber(text(rest)?);
                let told = move |s: Sample| drop(out.send(sample(id, &s)));
                Declared::Subscriber(subscriber.callback(told).wait()?)
            }
            4 => {
                let token = self.session.liveliness().declare_token(text(rest)?);
                Declared::Token(token.wait()?)
            }
            5 => {
                self.declared.remove(&id);
                return Ok(());
            }
            6 => {
                let liveliness = self.session.liveliness();
                let subscriber = liveliness.declare_subscriber(text(rest)?).history(true);
                let told = move |s: Sample| drop(out.send(token(id, &s)));
                Declared::Subscriber(subscriber.callback(told).wait()?)
            }
            7 => self.keep(rest)?,
            8 => self.catch_up(id, rest)?,
            9 => self.serve(id, rest)?,
            10 => return self.ask(id, rest),
            11 | 12 => return self.answer(what == 11, id, rest),
            _ => return Err("no such command".into()),
        };
        self.declared.insert(id, new);
        Ok(())
    }

    fn put(&mut self, id: u32, rest: &[u8]) -> Result<(), Any> {
        let (attachment, payload) = part(rest).ok_or("a put that is cut short")?;
        match self.declared.get(&id) {
            Some(Declared::Publisher(publisher)) => {
                publisher.put(payload).attachment(attachment).wait()?;
            }
            Some(Declared::Keeper(publisher)) => {
                publisher.put(payload).attachment(attachment).wait()?;
            }
            _ => return Err("no such publisher".into()),
        }
        drop(self.out.send(said(4, id, &[])));
        Ok(())
    }

    /// A topic whose last samples stay, as `rmw_zenoh` has durability TRANSIENT_LOCAL with reliability RELIABLE.
    fn keep(&mut self, rest: &[u8]) -> Result<Declared, Any> {
        let (depth, key) = number(rest).ok_or("a publisher that is cut short")?;
        let publisher = self.session.declare_publisher(text(key)?);
        let publisher = publisher
            .congestion_control(CongestionControl::Block)
            .cache(CacheConfig::default().max_samples(depth as usize))
            .publisher_detection()
            .sample_miss_detection(MissDetectionConfig::default());
        Ok(Declared::Keeper(Box::new(publisher.wait()?)))
    }

    fn catch_up(&mut self, id: u32, rest: &[u8]) -> Result<Declared, Any> {
        let (depth, key) = number(rest).ok_or("a subscriber that is cut short")?;
        let out = self.out.clone();
        let history = HistoryConfig::default()
            .detect_late_publishers()
            .max_samples(depth as usize);
        let subscriber = self.session.declare_subscriber(text(key)?);
        let subscriber = subscriber
            .callback(move |s: Sample| drop(out.send(sample(id, &s))))
            .history(history)
            .recovery(RecoveryConfig::default().heartbeat())
            .subscriber_detection();
        Ok(Declared::LateSubscriber(subscriber.wait()?))
    }

    fn serve(&mut self, id: u32, rest: &[u8]) -> Result<Declared, Any> {
        let (out, next) = (self.out.clone(), AtomicU32::new(0));
        let waiting = Waiting::default();
        let held = waiting.clone();
        let asked = move |query: Query| {
            let request = next.fetch_add(1, Ordering::Relaxed);
            let payload = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
            let attachment = attached(query.attachment());
            let frame = said(5, id, &[&request.to_be_bytes(), &attachment, &payload]);
            drop(payload);
            let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
            if held.len() < MOST_WAITING {
                held.insert(request, query);
                drop(out.send(frame));
            } else {
                drop(query.reply_err("too many requests wait").wait());
            }
        };
        let service = self.session.declare_queryable(text(rest)?);
        let service = service.complete(true).callback(asked).wait()?;
        Ok(Declared::Service(service, waiting))
    }

    fn answer(&mut self, well: bool, id: u32, rest: &[u8]) -> Result<(), Any> {
        let (request, rest) = number(rest).ok_or("an answer that is cut short")?;
        let Some(Declared::Service(service, waiting)) = self.declared.get(&id) else {
            return Err("no such service".into());
        };
        let query = {
            let mut waiting = waiting.lock().unwrap_or_else(PoisonError::into_inner);
            waiting.remove(&request).ok_or("no such request")?
        };
        if well {
            let (attachment, payload) = part(rest).ok_or("an answer that is cut short")?;
            let reply = query.reply(service.key_expr(), payload);
            reply.attachment(attachment).wait()
        } else {
            query.reply_err(rest).wait()
        }
    }

    fn ask(&mut self, id: u32, rest: &[u8]) -> Result<(), Any> {
        let cut = "a request that is cut short";
        let (ms, rest) = number(rest).ok_or(cut)?;
        let (key, rest) = part(rest).ok_or(cut)?;
        let (attachment, payload) = part(rest).ok_or(cut)?;
        let asked = Asked(id, self.out.clone());
        let told = move |reply: Reply| asked.hear(&reply);
        self.session
            .get(text(key)?)
            .payload(payload)
            .attachment(attachment)
            .target(QueryTarget::AllComplete)
            .consolidation(ConsolidationMode::None)
            .timeout(Duration::from_millis(u64::from(ms)))
            .callback(told)
            .wait()
    }
}

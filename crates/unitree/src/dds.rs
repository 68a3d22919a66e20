//! DDS, as a G1's programs speak it: samples of XCDR1 on topics without keys.

use std::marker::PhantomData;
use std::net::IpAddr;

use rustdds::bytes::Bytes;
use rustdds::no_key::{DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter, SimpleDataReader};
use rustdds::policy::{Durability, History, Reliability};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, QosPolicyBuilder, RepresentationIdentifier, TopicKind,
};
use thiserror::Error;

use crate::cdr::Message;

pub(crate) const LOW_CMD: &str = "rt/lowcmd";
pub(crate) const LOW_STATE: &str = "rt/lowstate";
pub(crate) const SWITCHER_REQUEST: &str = "rt/api/motion_switcher/request";
pub(crate) const SWITCHER_RESPONSE: &str = "rt/api/motion_switcher/response";

/// Samples that wait for their reader; at 500 Hz of some 60 ms.
const WAITING: i32 = 32;

/// DDS does not start.
#[derive(Debug, Error)]
#[error("DDS does not start in domain {domain}: {reason}")]
pub struct DdsError {
    domain: u16,
    reason: String,
}

/// A place in a domain.
pub struct Bus {
    participant: DomainParticipant,
    domain: u16,
}

/// A message as it is on the wire, with its encapsulation header.
struct Sample(Vec<u8>);

/// Passes samples on as they are.
#[derive(Clone)]
struct AsTheyAre;

impl SerializerAdapter<Sample> for AsTheyAre {
    type Error = std::convert::Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Sample) -> Result<Bytes, Self::Error> {
        // The library writes the header of four bytes itself.
        Ok(Bytes::copy_from_slice(value.0.get(4..).unwrap_or_default()))
    }
}

impl DeserializerAdapter<Sample> for AsTheyAre {
    type Error = std::convert::Infallible;
    type Decoded = Sample;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Sample) -> Sample {
        decoded
    }
}

impl Decode<'_, Sample> for AsTheyAre {
    type Error = std::convert::Infallible;

    fn decode_bytes(self, bytes: &[u8], encoding: RepresentationIdentifier) -> Result<Sample, Self::Error> {
        let [first, second] = encoding.to_bytes();
        Ok(Sample([[first, second, 0, 0].as_slice(), bytes].concat()))
    }
}

impl DefaultDecoder<Sample> for AsTheyAre {
    type Decoder = Self;
    const DECODER: Self = Self;
}

impl Bus {
    /// Joins a domain, on all of this machine's networks or on that of one address alone.
    ///
    /// # Errors
    /// [`DdsError`]: no socket, or the address is not this machine's.
    pub fn open(domain: u16, address: Option<IpAddr>) -> Result<Self, DdsError> {
        let mut builder = DomainParticipantBuilder::new(domain);
        if let Some(address) = address {
            builder = builder.with_only_networks([address]);
        }
        let failed = |error: rustdds::dds::CreateError| DdsError { domain, reason: error.to_string() };
        Ok(Self { participant: builder.build().map_err(failed)?, domain })
    }

    fn failed(&self, error: impl std::fmt::Display) -> DdsError {
        DdsError { domain: self.domain, reason: error.to_string() }
    }

    fn quality(reliability: Reliability, depth: i32) -> QosPolicies {
        let builder = QosPolicyBuilder::new().reliability(reliability).durability(Durability::Volatile);
        builder.history(History::KeepLast { depth }).build()
    }

    /// Offers a topic. Reliable, as the maker's programs write.
    ///
    /// # Errors
    /// [`DdsError`].
    pub fn writer<M: Message>(&self, topic: &str) -> Result<Writer<M>, DdsError> {
        let reliable = Reliability::Reliable { max_blocking_time: rustdds::Duration::from_millis(100) };
        let quality = Self::quality(reliable, 1);
        let publisher = self.participant.create_publisher(&quality).map_err(|error| self.failed(error))?;
        let topic = self.participant.create_topic(topic.into(), M::TYPE.into(), &quality, TopicKind::NoKey);
        let topic = topic.map_err(|error| self.failed(error))?;
        let writer = publisher.create_datawriter_no_key(&topic, Some(quality)).map_err(|error| self.failed(error))?;
        Ok(Writer { writer, of: PhantomData })
    }

    /// Reads a topic, whoever writes there.
    ///
    /// # Errors
    /// [`DdsError`].
    pub fn reader<M: Message>(&self, topic: &str) -> Result<Reader<M>, DdsError> {
        let quality = Self::quality(Reliability::BestEffort, WAITING);
        let subscriber = self.participant.create_subscriber(&quality).map_err(|error| self.failed(error))?;
        let topic = self.participant.create_topic(topic.into(), M::TYPE.into(), &quality, TopicKind::NoKey);
        let topic = topic.map_err(|error| self.failed(error))?;
        let reader = subscriber.create_simple_datareader_no_key(&topic, Some(quality));
        Ok(Reader { reader: reader.map_err(|error| self.failed(error))?, of: PhantomData })
    }
}

/// A topic that is offered.
pub struct Writer<M> {
    writer: DataWriter<Sample, AsTheyAre>,
    of: PhantomData<fn(M)>,
}

impl<M: Message> Writer<M> {
    /// Sends a message; one that nobody can take is lost, as on the robot.
    pub fn write(&self, message: &M) {
        if let Err(error) = self.writer.write(Sample(message.to_cdr()), None) {
            tracing::debug!("a sample of {} was not sent: {error}", M::TYPE);
        }
    }
}

/// A topic that is read.
pub struct Reader<M> {
    reader: SimpleDataReader<Sample, AsTheyAre>,
    of: PhantomData<fn() -> M>,
}

impl<M: Message> Reader<M> {
    /// The next message that waits. One that cannot be read is said in the log and left out.
    pub fn take(&mut self) -> Option<M> {
        loop {
            match self.reader.try_take_one() {
                Ok(None) => return None,
                Ok(Some(change)) => match M::from_cdr(&change.into_value().0) {
                    Ok(message) => return Some(message),
                    Err(error) => tracing::warn!("a sample of {} is left out: {error}", M::TYPE),
                },
                Err(error) => {
                    tracing::debug!("a sample of {} is left out: {error}", M::TYPE);
                    return None;
                }
            }
        }
    }
}

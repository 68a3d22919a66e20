"""Checks our bags with the official MCAP and Foxglove libraries.

    python3 tests/oracle/bags.py BAG...      checks bags; exit code 1 when one fails

Every record, checksum, index and statistic is checked, every message is decoded with the schema in the file, /tf,
/scene, /camera and /lidar also as the official Foxglove messages; then the file is cut at 20 places, and all whole chunks must be readable.
Makes its own virtual environment in target/ on the first run.
"""

import argparse
import io
import random
import struct
import sys
import zlib
from collections import Counter
from pathlib import Path

import environment

HERE = Path(__file__).resolve().parent
VENV = HERE.parents[1] / "target" / "bags-venv"

STEP_NS = 20_000_000
MAGIC = b"\x89MCAP0\r\n"
HEAD = 9
CUTS = 20
GRADED = {"/state", "/event", "/result"}


def top_level(data):
    """(opcode, offset, end) of each whole record outside of chunks."""
    at = len(MAGIC)
    while at + HEAD <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if at + HEAD + length > len(data):
            return
        yield opcode, at, at + HEAD + length
        at += HEAD + length


def check_layout(data):
    """Checksums and offsets, by the bytes of the file alone."""
    records = list(top_level(data))
    opcodes = [opcode for opcode, _, _ in records]
    assert data[: len(MAGIC)] == MAGIC and data[-len(MAGIC) :] == MAGIC, "magic"
    assert opcodes[:2] == [0x01, 0x0C], "the header's metadata comes first"
    assert opcodes[-1] == 0x02 and records[-1][2] == len(data) - len(MAGIC), "the footer comes last"
    _, data_end, after = records[opcodes.index(0x0F)]
    (crc,) = struct.unpack_from("<I", data, data_end + HEAD)
    assert crc == zlib.crc32(data[:data_end]) != 0, "checksum of the data section"
    footer = records[-1][1]
    summary_start, offset_start, crc = struct.unpack_from("<QQI", data, footer + HEAD)
    assert summary_start == after, "start of the summary"
    assert crc == zlib.crc32(data[summary_start : footer + HEAD + 16]) != 0, "checksum of the summary"
    groups = {}
    for opcode, start, end in records:
        if summary_start <= start < offset_start:
            first, _ = groups.get(opcode, (start, end))
            groups[opcode] = (first, end)
    offsets = [(start, end) for opcode, start, end in records if opcode == 0x0E]
    assert len(offsets) == len(groups), "an offset for each group of the summary"
    for start, _ in offsets:
        opcode, first, length = struct.unpack_from("<BQQ", data, start + HEAD)
        assert groups[opcode] == (first, first + length), f"offset of group {opcode}"


def check_records(data):
    """Chunks, indexes and statistics; returns the messages and what the file says of itself."""
    from mcap.reader import make_reader
    from mcap.records import Channel, Chunk, Message, MessageIndex, Metadata, Schema
    from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream

    summary = make_reader(io.BytesIO(data), validate_crcs=True).get_summary()
    starts = [(start, end) for opcode, start, end in top_level(data) if opcode == 0x06]
    found, messages, counts, metadata = {"schemas": {}, "channels": {}}, [], Counter(), []
    chunks, chunk, indexed = [], None, {}
    for record in StreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records:
        if isinstance(record, Metadata):
            metadata.append(record)
        elif isinstance(record, MessageIndex):
            assert indexed[record.channel_id] == [tuple(entry) for entry in record.records], "message index"
            del indexed[record.channel_id]
        elif isinstance(record, Chunk):
            assert not indexed, "an index for each channel of a chunk"
            chunk = record
            assert chunk.compression == "zstd" and chunk.uncompressed_crc != 0
            stream, length = get_chunk_data_stream(chunk, validate_crc=True)
            unpacked, at, position, times, topics = stream.read(length), 0, {}, [], set()
            while at < length:
                opcode, size = struct.unpack_from("<BQ", unpacked, at)
                if opcode == 0x05:
                    channel_id, _, log_time = struct.unpack_from("<HIQ", unpacked, at + HEAD)
                    position.setdefault(channel_id, []).append((log_time, at))
                at += HEAD + size
            assert at == length, "records fill the chunk"
            indexed = dict(position)
            for item in breakup_chunk(chunk, validate_crc=True):
                if isinstance(item, Schema):
                    assert found["schemas"].setdefault(item.id, item) == item, "a schema does not change"
                elif isinstance(item, Channel):
                    assert item.schema_id in found["schemas"] and item.message_encoding == "protobuf"
                    assert found["channels"].setdefault(item.id, item) == item, "a channel does not change"
                elif isinstance(item, Message):
                    channel = found["channels"][item.channel_id]
                    assert item.log_time == item.publish_time == item.sequence * STEP_NS, "times"
                    assert not times or item.log_time >= times[-1], "log times rise in a chunk"
                    times.append(item.log_time)
                    topics.add(channel.topic)
                    counts[item.channel_id] += 1
                    messages.append((channel, item))
            assert topics <= GRADED or not topics & GRADED, "graded topics have chunks of their own"
            bounds = (min(times, default=0), max(times, default=0))
            assert (chunk.message_start_time, chunk.message_end_time) == bounds, "times of a chunk"
            chunks.append((chunk, set(position)))
    assert summary.schemas == found["schemas"] and summary.channels == found["channels"], "the summary repeats them"
    assert len(summary.chunk_indexes) == len(chunks)
    for index, (start, end), (chunk, channels) in zip(summary.chunk_indexes, starts, chunks):
        assert (index.chunk_start_offset, index.chunk_length) == (start, end - start), "place of a chunk"
        assert set(index.message_index_offsets) == channels, "indexes of a chunk"
        assert (index.message_start_time, index.message_end_time) == (chunk.message_start_time, chunk.message_end_time)
        assert (index.compressed_size, index.uncompressed_size) == (len(chunk.data), chunk.uncompressed_size)
        for channel, offset in index.message_index_offsets.items():
            assert struct.unpack_from("<BQH", data, offset)[::2] == (0x07, channel), "place of a message index"
    statistics = summary.statistics
    assert statistics.message_count == len(messages) and statistics.channel_message_counts == dict(counts)
    assert (statistics.chunk_count, statistics.metadata_count) == (len(chunks), len(metadata))
    assert (statistics.schema_count, statistics.channel_count) == (len(found["schemas"]), len(found["channels"]))
    times = [message.log_time for _, message in messages]
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))
    for index, record in zip(summary.metadata_indexes, metadata, strict=True):
        assert index.name == record.name and data[index.offset] == 0x0C
    last = {}
    for channel, message in messages:
        assert last.get(channel.topic, 0) <= message.log_time, f"log times of {channel.topic} rise"
        last[channel.topic] = message.log_time
    assert metadata[0].name == "fiatlux" and metadata[-1].name in ("fiatlux.result", "fiatlux.cut")
    if metadata[-1].name == "fiatlux.result":
        assert messages[-1][0].topic == "/result", "the result is the last message"
    return summary, messages, metadata


def check_messages(summary, messages):
    """Decodes every message with the file's schema, and poses and shapes as the official ones."""
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
    from google.protobuf.json_format import MessageToDict
    from google.protobuf.unknown_fields import UnknownFieldSet
    from mcap_protobuf.decoder import DecoderFactory

    official = {"/tf": FrameTransforms, "/scene": SceneUpdate, "/camera": CompressedImage, "/lidar": PointCloud}
    decoders = DecoderFactory()
    frames, entities, sensors = {"world"}, set(), set()
    for channel, message in messages:
        schema = summary.schemas[channel.schema_id]
        assert schema.encoding == "protobuf"
        decoded = decoders.decoder_for("protobuf", schema)(message.data)
        assert decoded.DESCRIPTOR.full_name == schema.name
        assert len(UnknownFieldSet(decoded)) == 0, f"{channel.topic} has unknown fields"
        if channel.topic in official:
            theirs = official[channel.topic].FromString(message.data)
            assert theirs.DESCRIPTOR.full_name == schema.name
            assert MessageToDict(theirs) == MessageToDict(decoded), f"{channel.topic} reads otherwise officially"
            if channel.topic == "/tf":
                frames.update(transform.child_frame_id for transform in theirs.transforms)
                for transform in theirs.transforms:
                    q = transform.rotation
                    assert abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1) < 1e-5
            elif channel.topic == "/camera":
                assert theirs.format == "png" and theirs.data.startswith(b"\x89PNG\r\n")
                sensors.add(theirs.frame_id)
            elif channel.topic == "/lidar":
                assert [field.name for field in theirs.fields] == ["x", "y", "z"] and theirs.point_stride == 12
                points = struct.iter_unpack("<fff", theirs.data)
                assert all(x * x + y * y + z * z < 10.0**2 for x, y, z in points), "a hit beyond the range"
                sensors.add(theirs.frame_id)
            else:
                entities.update(entity.frame_id for entity in theirs.entities)
    assert entities <= frames, f"frames of shapes without poses: {entities - frames}"
    assert sensors <= frames, f"frames of sensors without poses: {sensors - frames}"
    return len(frames), len(entities)


def check_cuts(data, name):
    """A file that is cut gives all chunks that are whole."""
    from mcap.exceptions import McapError
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    ends = [end for opcode, _, end in top_level(data) if opcode == 0x06]
    draw = random.Random(name)
    for _ in range(CUTS):
        cut = draw.randrange(len(data))
        whole = 0
        try:
            for record in StreamReader(io.BytesIO(data[:cut]), emit_chunks=True).records:
                if isinstance(record, Chunk):
                    for _ in breakup_chunk(record, validate_crc=True):
                        pass
                    whole += 1
        except (McapError, struct.error, EOFError):
            pass
        expected = sum(end <= cut for end in ends)
        assert whole == expected, f"cut at byte {cut}: {whole} chunks instead of {expected}"
    return len(ends)


def check(path):
    data = path.read_bytes()
    check_layout(data)
    summary, messages, metadata = check_records(data)
    frames, entities = check_messages(summary, messages)
    chunks = check_cuts(data, path.name)
    counts = Counter(channel.topic for channel, _ in messages)
    topics = ", ".join(f"{topic} {count}" for topic, count in sorted(counts.items()))
    print(
        f"{path}: {len(data)} bytes, {chunks} chunks, {len(messages)} messages ({topics}), {frames} frames, "
        f"{entities} frames with shapes, metadata {', '.join(record.name for record in metadata)}: fine"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG")
    failed = False
    for path in parser.parse_args().bags:
        try:
            check(path)
        except Exception as error:
            failed = True
            print(f"{path}: {type(error).__name__}: {error}")
            if not isinstance(error, AssertionError):
                raise
    sys.exit(failed)


if __name__ == "__main__":
    environment.enter(__file__, VENV, HERE / "bags.requirements.txt")
    main()

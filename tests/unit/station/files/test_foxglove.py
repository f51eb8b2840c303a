"""Images in recordings: what stations wrote before they used Foxglove's own protobuf classes is the same message."""

from __future__ import annotations

from contextlib import suppress

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st

from shared.errors import DataError
from shared.mcap_recording import decode_image
from station.files.foxglove import encode_image, image_schema

T_NS, JPEG = 1_403_715_273_262_142_976, b"\xff\xd8jpeg"
# As written until November 2026, other order of the fields and a schema without what protobuf itself adds.
OLD_IMAGE = bytes.fromhex("0a0b08c9fdab9d051080f8ff7c220663616d6572611a046a7065671206ffd86a706567")
OLD_SCHEMA = bytes.fromhex(
    "0a670a1f676f6f676c652f70726f746f6275662f74696d657374616d702e70726f746f120f676f6f676c652e70726f746f627566222b0a0954"
    "696d657374616d70120f0a077365636f6e6473180120012803120d0a056e616e6f73180220012805620670726f746f330ac5010a1e666f7867"
    "6c6f76652f436f6d70726573736564496d6167652e70726f746f1208666f78676c6f76651a1f676f6f676c652f70726f746f6275662f74696d"
    "657374616d702e70726f746f22700a0f436f6d70726573736564496d616765122d0a0974696d657374616d7018012001280b321a2e676f6f67"
    "6c652e70726f746f6275662e54696d657374616d7012100a086672616d655f6964180420012809120c0a046461746118022001280c120e0a06"
    "666f726d6174180320012809620670726f746f33"
)


def fields(schema: bytes) -> list[tuple[str, str, str, int, int, int, str]]:
    return [
        (file.package, message.name, field.name, field.number, field.type, field.label, field.type_name)
        for file in FileDescriptorSet.FromString(schema).file
        for message in file.message_type
        for field in message.field
    ]


def test_old_and_new_images_are_the_same_message_and_are_read_without_protobuf() -> None:
    assert CompressedImage.FromString(OLD_IMAGE) == CompressedImage.FromString(encode_image(T_NS, JPEG))
    assert decode_image(OLD_IMAGE) == decode_image(encode_image(T_NS, JPEG)) == JPEG


def test_old_and_new_schemas_describe_the_same_fields() -> None:
    assert len(fields(OLD_SCHEMA)) == 6 and fields(image_schema()) == fields(OLD_SCHEMA)


@given(t_ns=st.integers(-(2**62), 2**62), jpeg=st.binary(max_size=500))
def test_images_survive_their_protobuf(t_ns: int, jpeg: bytes) -> None:
    encoded = encode_image(t_ns, jpeg)
    assert decode_image(encoded) == jpeg
    time = CompressedImage.FromString(encoded).timestamp
    assert time.seconds * 10**9 + time.nanos == t_ns


@given(st.binary(max_size=60))
def test_what_is_no_image_message_is_refused_or_read(data: bytes) -> None:
    with suppress(DataError):
        assert isinstance(decode_image(data), bytes)

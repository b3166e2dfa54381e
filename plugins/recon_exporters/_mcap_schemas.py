"""Foxglove's messages, field by field as its .proto files have them, and those of Google that they use.

Only fields that no version has changed: viewers know the messages by name and read them by these descriptors.

References
    Foxglove schemas, docs.foxglove.dev/docs/visualization/message-schemas; google/protobuf/timestamp.proto.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

_POSE_AND_COLOR: Final = "foxglove.Pose pose = 1; foxglove.Vector3 size = 2; foxglove.Color color = 3;"

DEFINITIONS: Final[Mapping[str, str]] = {
    "google.protobuf.Timestamp": "int64 seconds = 1; int32 nanos = 2;",
    "google.protobuf.Duration": "int64 seconds = 1; int32 nanos = 2;",
    "foxglove.Color": "double r = 1; double g = 2; double b = 3; double a = 4;",
    "foxglove.KeyValuePair": "string key = 1; string value = 2;",
    "foxglove.Vector3": "double x = 1; double y = 2; double z = 3;",
    "foxglove.Point3": "double x = 1; double y = 2; double z = 3;",
    "foxglove.Quaternion": "double x = 1; double y = 2; double z = 3; double w = 4;",
    "foxglove.Pose": "foxglove.Vector3 position = 1; foxglove.Quaternion orientation = 2;",
    "foxglove.PoseInFrame": "google.protobuf.Timestamp timestamp = 1; string frame_id = 2; foxglove.Pose pose = 3;",
    "foxglove.FrameTransform": """
        google.protobuf.Timestamp timestamp = 1; string parent_frame_id = 2; string child_frame_id = 3;
        foxglove.Vector3 translation = 4; foxglove.Quaternion rotation = 5;""",
    "foxglove.Odometry": """
        google.protobuf.Timestamp timestamp = 1; string frame_id = 2; string body_frame_id = 3;
        foxglove.Pose pose = 4; foxglove.Vector3 linear_velocity = 5; foxglove.Vector3 angular_velocity = 6;
        repeated double pose_covariance = 7; repeated double velocity_covariance = 8;""",
    "foxglove.LocationFix": """
        google.protobuf.Timestamp timestamp = 6; string frame_id = 7;
        double latitude = 1; double longitude = 2; double altitude = 3; repeated double position_covariance = 4;
        foxglove.LocationFix.PositionCovarianceType position_covariance_type = 5;
        foxglove.Color color = 8; repeated foxglove.KeyValuePair metadata = 9;""",
    "foxglove.LocationFix.PositionCovarianceType": "UNKNOWN = 0; APPROXIMATED = 1; DIAGONAL_KNOWN = 2; KNOWN = 3;",
    "foxglove.GeoJSON": "string geojson = 1;",
    "foxglove.Event": """
        google.protobuf.Timestamp start_time = 1; google.protobuf.Timestamp end_time = 2;
        repeated foxglove.KeyValuePair metadata = 3;""",
    "foxglove.Log": """
        google.protobuf.Timestamp timestamp = 1; foxglove.Log.Level level = 2; string message = 3; string name = 4;
        string file = 5; fixed32 line = 6;""",
    "foxglove.Log.Level": "UNKNOWN = 0; DEBUG = 1; INFO = 2; WARNING = 3; ERROR = 4; FATAL = 5;",
    "foxglove.ArrowPrimitive": """
        foxglove.Pose pose = 1; double shaft_length = 2; double shaft_diameter = 3; double head_length = 4;
        double head_diameter = 5; foxglove.Color color = 6;""",
    "foxglove.CubePrimitive": _POSE_AND_COLOR,
    "foxglove.SpherePrimitive": _POSE_AND_COLOR,
    "foxglove.CylinderPrimitive": """
        foxglove.Pose pose = 1; foxglove.Vector3 size = 2; double bottom_scale = 3; double top_scale = 4;
        foxglove.Color color = 5;""",
    "foxglove.LinePrimitive": """
        foxglove.LinePrimitive.Type type = 1; foxglove.Pose pose = 2; double thickness = 3; bool scale_invariant = 4;
        repeated foxglove.Point3 points = 5; foxglove.Color color = 6; repeated foxglove.Color colors = 7;
        repeated fixed32 indices = 8;""",
    "foxglove.LinePrimitive.Type": "LINE_STRIP = 0; LINE_LOOP = 1; LINE_LIST = 2;",
    "foxglove.TriangleListPrimitive": """
        foxglove.Pose pose = 1; repeated foxglove.Point3 points = 2; foxglove.Color color = 3;
        repeated foxglove.Color colors = 4; repeated fixed32 indices = 5;""",
    "foxglove.TextPrimitive": """
        foxglove.Pose pose = 1; bool billboard = 2; double font_size = 3; bool scale_invariant = 4;
        foxglove.Color color = 5; string text = 6;""",
    "foxglove.ModelPrimitive": """
        foxglove.Pose pose = 1; foxglove.Vector3 scale = 2; foxglove.Color color = 3; bool override_color = 4;
        string url = 5; string media_type = 6; bytes data = 7;""",
    "foxglove.SceneEntity": """
        google.protobuf.Timestamp timestamp = 1; string frame_id = 2; string id = 3;
        google.protobuf.Duration lifetime = 4; bool frame_locked = 5; repeated foxglove.KeyValuePair metadata = 6;
        repeated foxglove.ArrowPrimitive arrows = 7; repeated foxglove.CubePrimitive cubes = 8;
        repeated foxglove.SpherePrimitive spheres = 9; repeated foxglove.CylinderPrimitive cylinders = 10;
        repeated foxglove.LinePrimitive lines = 11; repeated foxglove.TriangleListPrimitive triangles = 12;
        repeated foxglove.TextPrimitive texts = 13; repeated foxglove.ModelPrimitive models = 14;""",
    "foxglove.SceneEntityDeletion": """
        google.protobuf.Timestamp timestamp = 1; foxglove.SceneEntityDeletion.Type type = 2; string id = 3;""",
    "foxglove.SceneEntityDeletion.Type": "MATCHING_ID = 0; ALL = 1;",
    "foxglove.SceneUpdate": """
        repeated foxglove.SceneEntityDeletion deletions = 1; repeated foxglove.SceneEntity entities = 2;""",
}

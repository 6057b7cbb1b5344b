defmodule Situ.Bridge.Mcap.Options do
  @moduledoc false
  # The options of the writers of MCAP files.

  def file do
    [
      profile: [type: :string, default: "", doc: "The file's profile, such as \"ros1\"."],
      compression: [
        type: {:in, [:none, :lz4, :zstd]},
        default: :lz4,
        doc: "How chunks are compressed."
      ],
      chunk: [
        type: :pos_integer,
        default: 1_048_576,
        doc: "Bytes of a chunk before it is compressed."
      ],
      attachments: [
        type: {:list, :any},
        default: [],
        doc:
          "Files that go into it as attachments, under their names: calibrations, maps, notes; or " <>
            "`{name, media_type, time, bytes}`."
      ],
      metadata: [
        type: :map,
        default: %{},
        doc: "Records of metadata: `%{\"robot\" => %{\"serial\" => \"7\"}}`."
      ]
    ]
  end

  def topic do
    [
      encoding: [
        type: {:in, [:auto, :json, :ros1, :cdr, :protobuf]},
        default: :auto,
        doc:
          "How messages are written; `:auto`: ROS 1 for data that a standard message fits, else JSON. `:cdr` " <>
            "is ROS 2, `:protobuf` Foxglove's own messages (`Situ.Bridge.Foxglove.Standard`) or any other by " <>
            "`definition:`."
      ],
      type: [
        type: {:optional, :string},
        default: nil,
        doc:
          "The type, such as \"sensor_msgs/Imu\" or \"foxglove.Log\"; by default the standard one that fits the " <>
            "first message."
      ],
      definition: [
        type: {:optional, :string},
        default: nil,
        doc:
          "The type's definition, when it is none of ROS's or Foxglove's own: the text of a `.msg` or a `.proto`, " <>
            "or a FileDescriptorSet."
      ],
      frame: [
        type: :string,
        default: "",
        doc: "The frame of reference that headers name."
      ]
    ]
  end
end

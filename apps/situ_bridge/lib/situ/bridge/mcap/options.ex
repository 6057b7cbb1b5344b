defmodule Situ.Bridge.Mcap.Options do
  @moduledoc false
  # The options of MCAP writers.

  def file_options do
    [
      profile: [type: :string, default: "", doc: "The profile of the file, such as \"ros1\"."],
      compression: [
        type: {:in, [:none, :lz4, :zstd]},
        default: :lz4,
        doc: "How chunks are compressed."
      ],
      chunk: [
        type: :pos_integer,
        default: 1_048_576,
        doc: "The size of a chunk before compression, bytes."
      ],
      attachments: [
        type: {:list, :any},
        default: [],
        doc:
          "Files to attach under their own names, such as calibrations, maps or notes; or " <>
            "`{name, media_type, time, bytes}`."
      ],
      metadata: [
        type: :map,
        default: %{},
        doc: "Metadata records, such as `%{\"robot\" => %{\"serial\" => \"7\"}}`."
      ]
    ]
  end

  def topic_options do
    [
      encoding: [
        type: {:in, [:auto, :json, :ros1, :cdr, :protobuf]},
        default: :auto,
        doc:
          "The message encoding. `:auto` selects ROS 1 if a standard message fits the data, otherwise JSON. `:cdr` " <>
            "is ROS 2. `:protobuf` writes Foxglove's messages (`Situ.Bridge.Foxglove`), or others " <>
            "given by `definition:`."
      ],
      type: [
        type: {:optional, :string},
        default: nil,
        doc:
          "The message type, such as \"sensor_msgs/Imu\" or \"foxglove.Log\"; the default is the standard type that " <>
            "fits the first message."
      ],
      definition: [
        type: {:optional, :string},
        default: nil,
        doc:
          "The definition of a type that is not a standard ROS or Foxglove type: the text of a `.msg` or `.proto` " <>
            "file, or a FileDescriptorSet."
      ],
      frame: [
        type: :string,
        default: "",
        doc: "The frame of reference to write in headers."
      ]
    ]
  end
end

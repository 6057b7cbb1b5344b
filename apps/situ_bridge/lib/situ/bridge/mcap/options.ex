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
      ]
    ]
  end

  def topic do
    [
      encoding: [
        type: {:in, [:auto, :json, :ros1, :cdr]},
        default: :auto,
        doc:
          "How messages are written; `:auto`: ROS 1 for data that a standard message fits, else JSON."
      ],
      type: [
        type: {:optional, :string},
        default: nil,
        doc:
          "The ROS type, such as \"sensor_msgs/Imu\"; by default the standard one that fits the first message."
      ],
      definition: [
        type: {:optional, :string},
        default: nil,
        doc: "The ROS type's definition (`.msg`), when it is none of ROS's own."
      ]
    ]
  end
end

defmodule Situ.Bridge.RawChannel do
  @moduledoc """
  A topic of an MCAP file or a ROS bag whose messages are not decoded (`Situ.Bridge.RawMessages`).

    * `topic`: its name. Several channels of a file may have the same topic.
    * `stream`: the name of its stream in `Situ.Store`, usually the topic.
    * `encoding`: how messages are encoded, such as `"ros1"`, `"cdr"`, `"protobuf"` or `"json"`.
    * `schema`: `{name, language, definition}`, such as `{"std_msgs/msg/Bool", "ros2msg", "bool data"}`, or `nil`.
    * `metadata`: pairs of strings, such as the MD5 sum of a ROS type or the offered quality of service.
    * `count`: the number of messages.
  """
  @enforce_keys [:id, :topic, :stream, :encoding]
  defstruct [:id, :topic, :stream, :encoding, :schema, :places, metadata: [], count: 0]

  @type t :: %__MODULE__{
          id: non_neg_integer(),
          topic: String.t(),
          stream: String.t(),
          encoding: String.t(),
          schema: {name :: String.t(), language :: String.t(), definition :: binary()} | nil,
          metadata: [{String.t(), String.t()}],
          count: non_neg_integer(),
          places: term()
        }

  @doc "Returns what channels of several files must share so that they become one channel of a new file."
  @spec identity(t()) :: term()
  def identity(%__MODULE__{} = channel) do
    metadata = Enum.sort(channel.metadata)
    {channel.topic, channel.encoding, channel.schema, metadata}
  end
end

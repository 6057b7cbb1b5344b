defmodule Situ.Bridge.Mcap.Codec do
  @moduledoc false
  # Decodes a channel's bytes by its message encoding and its schema. Messages of unknown types stay bytes, with a note.
  alias Situ.Bridge.Foxglove
  alias Situ.Bridge.Mcap.ExtraFields
  alias Situ.Bridge.Protobuf
  alias Situ.Bridge.Ros.{Definition, StandardTypes, Wire}

  @type schema :: {name :: String.t(), encoding :: String.t(), data :: binary()} | nil

  # `schema` is the definition or schema that bytes are decoded with. With `maps?`, standard messages stay maps with all
  # their fields.
  @enforce_keys [:kind]
  defstruct [:kind, :schema, :name, topic: "", maps?: false, extra?: false]

  @type t :: %__MODULE__{
          kind: :json | :bytes | :ros1 | :cdr | :protobuf,
          schema: Definition.t() | Protobuf.schema() | nil,
          name: String.t() | nil,
          topic: String.t(),
          maps?: boolean(),
          extra?: boolean()
        }

  @schema [
    messages: [
      type: {:in, [:situ, :maps, :apart]},
      default: :situ,
      doc:
        "`:situ`: standard messages become Situ's types (images, point clouds, poses, IMU readings ...). `:maps`: " <>
          "they stay maps with all their fields, including frames of reference and covariances. `:apart`: they " <>
          "become Situ's types, and the other fields go to a second stream, NAME.extra; imports of recordings do this."
    ]
  ]

  @times [
    times: [
      type: {:in, [:log, :header]},
      default: :log,
      doc:
        "The originating time of a message: when it was recorded (`:log`), or the stamp of its header, if it has " <>
          "one (`:header`). Stamps are read when the file is opened. `creation_time` is when the message was recorded."
    ]
  ]

  @doc "Returns the options of readers."
  @spec reader_options() :: Situ.Options.schema()
  def reader_options, do: @schema

  @doc "Returns the option of bags that selects their originating times."
  @spec time_options() :: Situ.Options.schema()
  def time_options, do: @times

  @doc "Builds the codec of a channel; returns it with its `Situ.Type`, and a note if its messages stay bytes."
  @spec new(String.t(), schema(), String.t()) :: {t(), Situ.Type.t(), String.t() | nil}
  def new(encoding, schema, topic \\ "")
  def new("json", _schema, topic), do: {%__MODULE__{kind: :json, topic: topic}, :any, nil}
  def new("ros1", {name, "ros1msg", text}, topic), do: ros_codec(name, text, :ros1, topic)
  def new("cdr", {name, "ros2msg", text}, topic), do: ros_codec(name, text, :cdr, topic)

  def new("protobuf", {name, "protobuf", set}, topic) do
    case Protobuf.parse_schema(set) do
      {:ok, %{messages: messages} = schema} when is_map_key(messages, name) ->
        codec = %__MODULE__{kind: :protobuf, schema: schema, name: name, topic: topic}
        {codec, Foxglove.StandardTypes.situ_type(name), nil}

      {:ok, _} ->
        bytes_codec(
          topic,
          "its definition does not contain the message #{name}, so its messages stay bytes"
        )

      {:error, error} ->
        bytes_codec(topic, Exception.message(error))
    end
  end

  def new(encoding, schema, topic) do
    description = if schema, do: "#{elem(schema, 0)} in #{elem(schema, 1)}", else: "no schema"

    bytes_codec(
      topic,
      "its messages are encoded as #{inspect(encoding)} (#{description}) and stay bytes"
    )
  end

  defp bytes_codec(topic, note), do: {%__MODULE__{kind: :bytes, topic: topic}, :binary, note}

  defp ros_codec(name, text, encoding, topic) do
    case Definition.parse(name, text, if(encoding == :ros1, do: :ros1, else: :ros2)) do
      {:ok, definition} ->
        name = definition.name
        codec = %__MODULE__{kind: encoding, schema: definition, name: name, topic: topic}
        {codec, StandardTypes.situ_type(name), nil}

      {:error, why} ->
        bytes_codec(topic, "its definition is invalid: #{why}")
    end
  end

  @doc "Returns the encoding of the header that the channel's messages begin with, or `nil` if they have none."
  @spec stamp_encoding(t()) :: :ros1_header | :cdr_header | nil
  def stamp_encoding(%{kind: kind, schema: definition}) when kind in [:ros1, :cdr] do
    case definition.types[definition.name].fields do
      [{_, {:message, "std_msgs/Header"}} | _] when kind == :cdr -> :cdr_header
      [{_, {:message, "std_msgs/Header"}} | _] -> :ros1_header
      _ -> nil
    end
  end

  def stamp_encoding(_), do: nil

  @doc "Returns the codec that decodes messages as the option `messages:` requires."
  @spec set_message_mode(t(), :situ | :maps | :apart) :: t()
  def set_message_mode(codec, messages), do: %{codec | maps?: messages == :maps}

  @doc "Makes the tracks of a reader, by their numbers, return messages as maps with all their fields."
  @spec read_maps(%{term() => map()}) :: %{term() => map()}
  def read_maps(tracks) do
    Map.new(tracks, fn {id, track} ->
      {id, %{track | codec: set_message_mode(track.codec, :maps)}}
    end)
  end

  @doc "Returns the options with which an import opens a file."
  @spec import_options(times :: atom()) :: keyword()
  def import_options(times),
    do: [messages: :apart, times: if(times == :header, do: :header, else: :log)]

  @doc "Returns whether messages may contain fields that the value of their type cannot hold."
  @spec lossy?(t(), Situ.Type.t()) :: boolean()
  def lossy?(%{kind: kind}, {:or, _}), do: kind in [:ros1, :cdr, :protobuf]
  def lossy?(_codec, _type), do: false

  @doc "Returns the codec of the second stream, which holds the fields that Situ's types cannot hold."
  @spec extra_codec(t()) :: t()
  def extra_codec(codec), do: %{codec | maps?: false, extra?: true}

  @doc "Adds the times of a message to the data of a second stream (`Situ.Bridge.Mcap.ExtraFields.put_times/3`)."
  @spec put_times(term(), t(), Situ.Time.t(), {recorded :: Situ.Time.t(), sent :: Situ.Time.t()}) ::
          term()
  def put_times(%{} = extra, %{extra?: true}, time, times) when not is_struct(extra),
    do: ExtraFields.put_times(extra, time, times)

  def put_times(data, _codec, _time, _times), do: data

  @doc "Decodes one message. The error is a sentence."
  @spec decode(t(), binary()) :: {:ok, term()} | {:error, String.t()}
  def decode(%{extra?: true} = codec, bytes) do
    with {:ok, message} <- decode(%{codec | extra?: false, maps?: true}, bytes),
         do: {:ok, ExtraFields.take_extra(message, rewrite_message(codec, message))}
  end

  def decode(%{kind: :bytes}, bytes), do: {:ok, bytes}

  def decode(%{kind: :json}, bytes) do
    with {:error, _} <- Situ.JSON.decode(bytes), do: {:error, "it is not JSON"}
  end

  def decode(%{kind: :protobuf} = codec, bytes) do
    with {:ok, message} <- Protobuf.Reader.decode(codec.schema, codec.name, bytes) do
      if codec.maps?,
        do: {:ok, message},
        else: {:ok, Foxglove.StandardTypes.from_message(codec.name, message)}
    end
  end

  def decode(codec, bytes), do: decode_ros(codec, bytes)

  # Returns the message that an export would write if it had only the value.
  defp rewrite_message(%{kind: :protobuf, name: name}, message) do
    value = Foxglove.StandardTypes.from_message(name, message)
    Foxglove.StandardTypes.to_message(name, value, 0)
  end

  defp rewrite_message(%{name: name, topic: topic}, message) do
    value = StandardTypes.from_message(name, message, topic)
    StandardTypes.to_message(name, value, 0)
  end

  defp decode_ros(codec, bytes) do
    with {:ok, message} <- Wire.decode(codec.schema, bytes, codec.kind) do
      if codec.maps?,
        do: {:ok, message},
        else: {:ok, StandardTypes.from_message(codec.name, message, codec.topic)}
    end
  end
end

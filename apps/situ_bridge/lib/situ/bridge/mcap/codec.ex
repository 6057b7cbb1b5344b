defmodule Situ.Bridge.Mcap.Codec do
  @moduledoc false
  # A channel's bytes as terms, by its message encoding and its schema. Unknown types stay bytes, with a note.
  alias Situ.Bridge.Foxglove
  alias Situ.Bridge.Mcap.Extra
  alias Situ.Bridge.Protobuf
  alias Situ.Bridge.Ros.{Definition, Standard, Wire}

  @type schema :: {name :: String.t(), encoding :: String.t(), data :: binary()} | nil

  # `by`: what bytes are read by; `maps?`: standard messages stay maps, with all that is in them.
  @enforce_keys [:kind]
  defstruct [:kind, :by, :name, topic: "", maps?: false, extra?: false]

  @type t :: %__MODULE__{
          kind: :json | :bytes | :ros1 | :cdr | :protobuf,
          by: Definition.t() | Protobuf.schema() | nil,
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
        "Standard messages as Situ's types (pictures, clouds, poses, inertial readings ...), or all as maps with " <>
          "everything that is in them, such as frames of reference and covariances. `:apart`: as Situ's types, with " <>
          "the other fields in a second stream, NAME.extra; imports of recordings do this."
    ]
  ]

  @times [
    times: [
      type: {:in, [:log, :header]},
      default: :log,
      doc:
        "Originating times: when a message was recorded, or the stamp of its header (the former where it has none). " <>
          "The stamps are read when the file is opened; `creation_time` is when a message was recorded."
    ]
  ]

  @doc "The options of readers."
  @spec options() :: Situ.Options.schema()
  def options, do: @schema

  @doc "The option of bags that chooses their originating times."
  @spec time_options() :: Situ.Options.schema()
  def time_options, do: @times

  @doc "How a channel is read, its `Situ.Type`, and a note when its messages stay bytes."
  @spec new(String.t(), schema(), String.t()) :: {t(), Situ.Type.t(), String.t() | nil}
  def new(encoding, schema, topic \\ "")
  def new("json", _schema, topic), do: {%__MODULE__{kind: :json, topic: topic}, :any, nil}
  def new("ros1", {name, "ros1msg", text}, topic), do: ros(name, text, :ros1, topic)
  def new("cdr", {name, "ros2msg", text}, topic), do: ros(name, text, :cdr, topic)

  def new("protobuf", {name, "protobuf", set}, topic) do
    case Protobuf.schema(set) do
      {:ok, %{messages: messages} = schema} when is_map_key(messages, name) ->
        codec = %__MODULE__{kind: :protobuf, by: schema, name: name, topic: topic}
        {codec, Foxglove.Standard.type(name), nil}

      {:ok, _} ->
        bytes(topic, "its definition has no message #{name}")

      {:error, error} ->
        bytes(topic, Exception.message(error))
    end
  end

  def new(encoding, schema, topic) do
    what = if schema, do: "#{elem(schema, 0)} in #{elem(schema, 1)}", else: "no schema"
    bytes(topic, "its messages are written as #{inspect(encoding)} (#{what}) and stay bytes")
  end

  defp bytes(topic, note), do: {%__MODULE__{kind: :bytes, topic: topic}, :binary, note}

  defp ros(name, text, encoding, topic) do
    case Definition.parse(name, text, if(encoding == :ros1, do: :ros1, else: :ros2)) do
      {:ok, definition} ->
        codec = %__MODULE__{kind: encoding, by: definition, name: definition.name, topic: topic}
        {codec, Standard.type(definition.name), nil}

      {:error, why} ->
        bytes(topic, "its definition cannot be used: #{why}")
    end
  end

  @doc "Whether its messages may begin with a stamp, and how that is written."
  @spec stamps(t()) :: :ros1_header | :cdr_header | nil
  def stamps(%{kind: kind, by: definition}) when kind in [:ros1, :cdr] do
    case definition.types[definition.name].fields do
      [{_, {:message, "std_msgs/Header"}} | _] when kind == :cdr -> :cdr_header
      [{_, {:message, "std_msgs/Header"}} | _] -> :ros1_header
      _ -> nil
    end
  end

  def stamps(_), do: nil

  @doc "The same, with its messages as the option `messages:` wants them."
  @spec shaped(t(), :situ | :maps | :apart) :: t()
  def shaped(codec, messages), do: %{codec | maps?: messages == :maps}

  @doc "Returns the options that an import opens a file with."
  @spec import_options(times :: atom()) :: keyword()
  def import_options(times),
    do: [messages: :apart, times: if(times == :header, do: :header, else: :log)]

  @doc "Whether messages may hold more than the value of their type has a place for."
  @spec lossy?(t(), Situ.Type.t()) :: boolean()
  def lossy?(%{kind: kind}, {:or, _}), do: kind in [:ros1, :cdr, :protobuf]
  def lossy?(_codec, _type), do: false

  @doc "Returns the codec of the second stream: of the fields that the values have no place for."
  @spec extra(t()) :: t()
  def extra(codec), do: %{codec | maps?: false, extra?: true}

  @doc "Adds the times of a message to the data of a second stream (`Situ.Bridge.Mcap.Extra.put_times/3`)."
  @spec put_times(term(), t(), Situ.Time.t(), {recorded :: Situ.Time.t(), sent :: Situ.Time.t()}) ::
          term()
  def put_times(%{} = extra, %{extra?: true}, time, times) when not is_struct(extra),
    do: Extra.put_times(extra, time, times)

  def put_times(data, _codec, _time, _times), do: data

  @doc "One message's data, or why it is none."
  @spec decode(t(), binary()) :: {:ok, term()} | {:error, String.t()}
  def decode(%{extra?: true} = codec, bytes) do
    with {:ok, message} <- decode(%{codec | extra?: false, maps?: true}, bytes),
         do: {:ok, Extra.take(message, rewrite(codec, message))}
  end

  def decode(%{kind: :bytes}, bytes), do: {:ok, bytes}

  def decode(%{kind: :json}, bytes) do
    with {:error, _} <- Situ.JSON.decode(bytes), do: {:error, "it is not JSON"}
  end

  def decode(%{kind: :protobuf} = codec, bytes) do
    with {:ok, message} <- Protobuf.Reader.decode(codec.by, codec.name, bytes) do
      if codec.maps?,
        do: {:ok, message},
        else: {:ok, Foxglove.Standard.from(codec.name, message)}
    end
  end

  def decode(codec, bytes), do: decode_ros(codec, bytes)

  # Returns the message that an export of its value alone would write.
  defp rewrite(%{kind: :protobuf, name: name}, message) do
    value = Foxglove.Standard.from(name, message)
    Foxglove.Standard.to(name, value, 0)
  end

  defp rewrite(%{name: name, topic: topic}, message) do
    value = Standard.from(name, message, topic)
    Standard.to(name, value, 0)
  end

  defp decode_ros(codec, bytes) do
    with {:ok, message} <- Wire.decode(codec.by, bytes, codec.kind) do
      if codec.maps?,
        do: {:ok, message},
        else: {:ok, Standard.from(codec.name, message, codec.topic)}
    end
  end
end

defmodule Situ.Bridge.Mcap.Channel do
  @moduledoc false
  # How one topic is written, as determined by its options and its first message.
  alias Situ.Bridge.Format.Value
  alias Situ.Bridge.Mcap.Extra
  alias Situ.Bridge.{Foxglove, Protobuf}
  alias Situ.Bridge.Protobuf.Descriptor
  alias Situ.Bridge.Ros.{Definition, Library, Optics, Standard, Wire}
  alias Situ.Error

  # `definition` is a `Definition` or a Protobuf schema.
  defstruct [:topic, :id, :encoding, :definition, :schema, frame: "", metadata: []]

  @type t :: %__MODULE__{}

  @doc "Builds the channel that fits the first message."
  @spec new(String.t(), keyword(), term()) :: {:ok, t()} | {:error, Error.t()}
  def new(topic, opts, first) do
    {value, _extra} = Extra.split(first)

    with {:ok, channel} <- made(topic, opts[:encoding], opts, value),
         do: {:ok, %{channel | frame: opts[:frame] || ""}}
  end

  defp made(topic, :json, _opts, _first), do: {:ok, json(topic)}

  defp made(topic, :protobuf, opts, first) do
    case opts[:type] || Foxglove.Standard.message_type(first) do
      nil -> {:error, no_type(topic, :protobuf, "Foxglove message")}
      type -> protobuf(topic, type, opts[:definition])
    end
  end

  defp made(topic, encoding, opts, first) do
    case {encoding, opts[:type] || Standard.ros_type(first)} do
      {:auto, nil} -> {:ok, json(topic)}
      {encoding, nil} -> {:error, no_type(topic, encoding, "ROS message")}
      {:auto, type} -> ros(topic, type, opts[:definition], :ros1)
      {encoding, type} -> ros(topic, type, opts[:definition], encoding)
    end
  end

  defp no_type(topic, encoding, what) do
    Error.new(:no_ros_type, "no standard #{what} fits the data of #{topic}",
      why: "the topic is to be encoded as #{encoding}, which needs a message type",
      fix: "name a type with `type:`, or write the topic with `encoding: :json`"
    )
  end

  defp json(topic),
    do: %__MODULE__{
      topic: topic,
      encoding: :json,
      schema: {"", "jsonschema", "{\"type\":\"object\"}"}
    }

  defp protobuf(topic, type, definition) do
    with {:ok, schema} <- protobuf_schema(definition) do
      if is_map_key(schema.messages, type) do
        set = Descriptor.write(schema, type)

        {:ok,
         %__MODULE__{
           topic: topic,
           encoding: :protobuf,
           definition: schema,
           schema: {type, "protobuf", set}
         }}
      else
        {:error,
         unknown(type, "neither its definition nor Foxglove's definitions contain this message")}
      end
    end
  end

  defp protobuf_schema(nil), do: {:ok, Foxglove.Messages.schema()}
  defp protobuf_schema(definition), do: Protobuf.schema(definition)

  defp unknown(type, why),
    do:
      Error.new(:no_definition, "the type #{type} is unknown",
        why: why,
        fix: "pass the text of its definition with `definition:`"
      )

  defp ros(topic, type, text, encoding) do
    dialect = if encoding == :ros1, do: :ros1, else: :ros2

    with {:ok, text} <- text(type, text, dialect),
         {:ok, definition} <- definition(type, text, dialect) do
      metadata =
        if encoding == :ros1,
          do: [{"md5sum", Definition.md5(definition)}, {"topic", topic}],
          else: []

      schema =
        {spelled(definition.name, dialect), language(dialect), whole(definition, text, dialect)}

      {:ok,
       %__MODULE__{
         topic: topic,
         encoding: encoding,
         definition: definition,
         schema: schema,
         metadata: metadata
       }}
    end
  end

  defp language(:ros1), do: "ros1msg"
  defp language(:ros2), do: "ros2msg"

  defp spelled(name, :ros1), do: name
  defp spelled(name, :ros2), do: String.replace(name, "/", "/msg/", global: false)

  defp text(type, nil, dialect) do
    with :error <- Library.fetch(Definition.plain(type), dialect),
         do: {:error, unknown(type, "it is not a standard ROS type")}
  end

  defp text(_type, text, _dialect), do: {:ok, text}

  defp definition(type, text, dialect) do
    with {:error, why} <- Definition.parse(type, text, dialect),
         do:
           {:error, Error.new(:bad_definition, "the definition of #{type} is invalid", why: why)}
  end

  # Readers expect the definitions of nested types to follow the type that uses them.
  defp whole(definition, text, dialect) do
    others = definition.types |> Map.keys() |> Enum.sort() |> List.delete(definition.name)
    missing = Enum.reject(others, &told?(text, &1))

    Enum.join(
      [
        text | for(name <- missing, do: "MSG: #{name}\n" <> elem(Library.fetch(name, dialect), 1))
      ],
      "\n" <> String.duplicate("=", 80) <> "\n"
    )
  end

  defp told?(text, name) do
    String.contains?(text, "MSG: " <> name) or
      String.contains?(text, "MSG: " <> String.replace(name, "/", "/msg/", global: false))
  end

  @doc "Encodes a message. Error: `:not_writable`."
  @spec encode(t(), term(), Situ.Time.t()) :: {:ok, binary()} | {:error, Error.t()}
  def encode(channel, {:with_extra, value, extra}, time), do: encode(channel, value, extra, time)
  def encode(channel, value, time), do: encode(channel, value, %{}, time)

  defp encode(%{encoding: :json} = channel, data, _extra, _time) do
    {:ok, data |> Value.plain() |> object() |> Situ.JSON.encode()}
  catch
    {:not_writable, what} ->
      {:error, not_writable(channel, "JSON cannot represent #{inspect(what, limit: 5)}")}
  end

  defp encode(%{encoding: :protobuf, schema: {type, _, _}} = channel, data, extra, time) do
    message = type |> Foxglove.Standard.to(data, time, channel.frame) |> Extra.put(extra)

    with {:error, why} <- Protobuf.Writer.encode(channel.definition, type, message),
         do: {:error, not_writable(channel, why)}
  end

  defp encode(%{definition: %{name: name} = definition} = channel, data, extra, time) do
    message =
      name
      |> Standard.to(data, time, channel.frame)
      |> Extra.put(extra)
      |> spelled_for(name, channel.encoding)

    with {:error, why} <- Wire.encode(definition, message, channel.encoding),
         do: {:error, not_writable(channel, why)}
  end

  # ROS 1 and ROS 2 use different names for the same four fields.
  defp spelled_for(%{} = message, "sensor_msgs/CameraInfo", encoding),
    do: Optics.spelled(message, encoding)

  defp spelled_for(message, _name, _encoding), do: message

  # Tools expect objects: any other value becomes the member `value` of an object.
  defp object({_} = object), do: object
  defp object(value), do: {[{"value", value}]}

  defp not_writable(channel, why),
    do: Error.new(:not_writable, "a message of #{channel.topic} cannot be written", why: why)
end

defmodule Situ.Bridge.Mcap.Channel do
  @moduledoc false
  # How one topic is written, as determined by its options and its first message.
  alias Situ.Bridge.Format.Value
  alias Situ.Bridge.Mcap.ExtraFields
  alias Situ.Bridge.{Foxglove, Protobuf}
  alias Situ.Bridge.Protobuf.Descriptor
  alias Situ.Bridge.Ros.{Definition, Library, CameraInfo, StandardTypes, Wire}
  alias Situ.Error

  # `definition` is a `Definition` or a Protobuf schema.
  defstruct [:topic, :id, :encoding, :definition, :schema, frame: "", metadata: []]

  @type t :: %__MODULE__{}

  @doc "Builds the channel that fits the first message."
  @spec new(String.t(), keyword(), term()) :: {:ok, t()} | {:error, Error.t()}
  def new(topic, opts, first) do
    {value, _extra} = ExtraFields.split_data(first)

    with {:ok, channel} <- build_channel(topic, opts[:encoding], opts, value),
         do: {:ok, %{channel | frame: opts[:frame] || ""}}
  end

  defp build_channel(topic, :json, _opts, _first), do: {:ok, json_channel(topic)}

  # ROS has no message for compressed video.
  defp build_channel(topic, :auto, opts, %Situ.VideoPacket{} = first),
    do: build_channel(topic, :protobuf, opts, first)

  defp build_channel(topic, :protobuf, opts, first) do
    case opts[:type] || Foxglove.StandardTypes.message_type(first) do
      nil -> {:error, no_type_error(topic, :protobuf, "Foxglove message")}
      type -> protobuf_channel(topic, type, opts[:definition])
    end
  end

  defp build_channel(topic, encoding, opts, first) do
    case {encoding, opts[:type] || StandardTypes.ros_type(first)} do
      {:auto, nil} -> {:ok, json_channel(topic)}
      {encoding, nil} -> {:error, no_type_error(topic, encoding, "ROS message")}
      {:auto, type} -> ros_channel(topic, type, opts[:definition], :ros1)
      {encoding, type} -> ros_channel(topic, type, opts[:definition], encoding)
    end
  end

  defp no_type_error(topic, encoding, family) do
    Error.new(:no_ros_type, "no standard #{family} fits the data of #{topic}",
      why: "the topic is to be encoded as #{encoding}, which needs a message type",
      fix: "name a type with `type:`, or write the topic with `encoding: :json`"
    )
  end

  defp json_channel(topic),
    do: %__MODULE__{
      topic: topic,
      encoding: :json,
      schema: {"", "jsonschema", "{\"type\":\"object\"}"}
    }

  defp protobuf_channel(topic, type, definition) do
    with {:ok, schema} <- protobuf_schema(definition) do
      if is_map_key(schema.messages, type) do
        set = Descriptor.encode_set(schema, type)

        {:ok,
         %__MODULE__{
           topic: topic,
           encoding: :protobuf,
           definition: schema,
           schema: {type, "protobuf", set}
         }}
      else
        {:error,
         unknown_type_error(
           type,
           "neither its definition nor Foxglove's definitions contain this message"
         )}
      end
    end
  end

  defp protobuf_schema(nil), do: {:ok, Foxglove.Messages.load_schema()}
  defp protobuf_schema(definition), do: Protobuf.parse_schema(definition)

  defp unknown_type_error(type, why),
    do:
      Error.new(:no_definition, "the type #{type} is unknown",
        why: why,
        fix: "pass the text of its definition with `definition:`"
      )

  defp ros_channel(topic, type, text, encoding) do
    dialect = if encoding == :ros1, do: :ros1, else: :ros2

    with {:ok, text} <- find_definition(type, text, dialect),
         {:ok, definition} <- parse_definition(type, text, dialect) do
      metadata =
        if encoding == :ros1,
          do: [{"md5sum", Definition.md5(definition)}, {"topic", topic}],
          else: []

      schema =
        {schema_name(definition.name, dialect), schema_language(dialect),
         complete_definition(definition, text, dialect)}

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

  defp schema_language(:ros1), do: "ros1msg"
  defp schema_language(:ros2), do: "ros2msg"

  defp schema_name(name, :ros1), do: name
  defp schema_name(name, :ros2), do: String.replace(name, "/", "/msg/", global: false)

  defp find_definition(type, nil, dialect) do
    with :error <- Library.fetch(Definition.strip_kind(type), dialect),
         do: {:error, unknown_type_error(type, "it is not a standard ROS type")}
  end

  defp find_definition(_type, text, _dialect), do: {:ok, text}

  defp parse_definition(type, text, dialect) do
    with {:error, why} <- Definition.parse(type, text, dialect),
         do:
           {:error, Error.new(:bad_definition, "the definition of #{type} is invalid", why: why)}
  end

  # Readers expect the definitions of nested types to follow the type that uses them.
  defp complete_definition(definition, text, dialect) do
    others = definition.types |> Map.keys() |> Enum.sort() |> List.delete(definition.name)
    missing = Enum.reject(others, &includes_type?(text, &1))

    Enum.join(
      [
        text | for(name <- missing, do: "MSG: #{name}\n" <> elem(Library.fetch(name, dialect), 1))
      ],
      "\n" <> String.duplicate("=", 80) <> "\n"
    )
  end

  defp includes_type?(text, name) do
    String.contains?(text, "MSG: " <> name) or
      String.contains?(text, "MSG: " <> String.replace(name, "/", "/msg/", global: false))
  end

  @doc "Encodes a message. Error: `:not_writable`."
  @spec encode(t(), term(), Situ.Time.t()) :: {:ok, binary()} | {:error, Error.t()}
  def encode(channel, {:with_extra, value, extra}, time),
    do: encode_value(channel, value, extra, time)

  def encode(channel, value, time), do: encode_value(channel, value, %{}, time)

  defp encode_value(%{encoding: :json} = channel, data, _extra, _time) do
    {:ok, data |> Value.to_plain() |> ensure_object() |> Situ.JSON.encode()}
  catch
    {:not_writable, value} ->
      {:error, not_writable_error(channel, "JSON cannot represent #{inspect(value, limit: 5)}")}
  end

  defp encode_value(%{encoding: :protobuf, schema: {type, _, _}} = channel, data, extra, time) do
    message =
      type
      |> Foxglove.StandardTypes.to_message(data, time, channel.frame)
      |> ExtraFields.put_fields(extra)

    with {:error, why} <- Protobuf.Writer.encode(channel.definition, type, message),
         do: {:error, not_writable_error(channel, why)}
  end

  defp encode_value(%{definition: %{name: name} = definition} = channel, data, extra, time) do
    message =
      name
      |> StandardTypes.to_message(data, time, channel.frame)
      |> ExtraFields.put_fields(extra)
      |> rename_fields(name, channel.encoding)

    with {:error, why} <- Wire.encode(definition, message, channel.encoding),
         do: {:error, not_writable_error(channel, why)}
  end

  # ROS 1 and ROS 2 use different names for the same four fields.
  defp rename_fields(%{} = message, "sensor_msgs/CameraInfo", encoding),
    do: CameraInfo.rename_matrices(message, encoding)

  defp rename_fields(message, _name, _encoding), do: message

  # Tools expect objects: any other value becomes the member `value` of an object.
  defp ensure_object({_} = object), do: object
  defp ensure_object(value), do: {[{"value", value}]}

  defp not_writable_error(channel, why),
    do: Error.new(:not_writable, "a message of #{channel.topic} cannot be written", why: why)
end

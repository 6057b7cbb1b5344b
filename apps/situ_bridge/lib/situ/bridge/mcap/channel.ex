defmodule Situ.Bridge.Mcap.Channel do
  @moduledoc false
  # How one topic is written: settled by its options and its first message.
  alias Situ.Bridge.Format.Value
  alias Situ.Bridge.Ros.{Definition, Library, Standard, Wire}
  alias Situ.Error

  defstruct [:topic, :id, :encoding, :definition, :schema, metadata: []]

  @doc "The channel that fits the first message."
  @spec new(String.t(), keyword(), term()) :: {:ok, %__MODULE__{}} | {:error, Error.t()}
  def new(topic, opts, first) do
    type = opts[:type] || Standard.ros_type(first)

    case {opts[:encoding], type} do
      {:json, _} ->
        {:ok, json(topic)}

      {:auto, nil} ->
        {:ok, json(topic)}

      {encoding, nil} ->
        {:error,
         Error.new(:no_ros_type, "no standard ROS message fits the data of #{topic}",
           why: "it is to be written as #{encoding}",
           fix: "name one with `type:`, or write it as JSON"
         )}

      {:auto, type} ->
        ros(topic, type, opts[:definition], :ros1)

      {encoding, type} ->
        ros(topic, type, opts[:definition], encoding)
    end
  end

  defp json(topic),
    do: %__MODULE__{
      topic: topic,
      encoding: :json,
      schema: {"", "jsonschema", "{\"type\":\"object\"}"}
    }

  defp ros(topic, type, text, encoding) do
    with {:ok, text} <- text(type, text),
         {:ok, definition} <- definition(type, text) do
      metadata =
        if encoding == :ros1,
          do: [{"md5sum", Definition.md5(definition)}, {"topic", topic}],
          else: []

      language = if encoding == :ros1, do: "ros1msg", else: "ros2msg"
      schema = {type, language, whole(definition, text)}

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

  defp text(type, nil) do
    with :error <- Library.fetch(Definition.plain(type)) do
      {:error,
       Error.new(:no_definition, "the ROS type #{type} is not known",
         why: "it is not one of ROS's standard types",
         fix: "give its text with `definition:`"
       )}
    end
  end

  defp text(_type, text), do: {:ok, text}

  defp definition(type, text) do
    with {:error, why} <- Definition.parse(type, text),
         do:
           {:error,
            Error.new(:bad_definition, "the definition of #{type} cannot be used", why: why)}
  end

  # Readers want the types that a type is made of behind it.
  defp whole(definition, text) do
    others = definition.types |> Map.keys() |> Enum.sort() |> List.delete(definition.name)
    missing = Enum.reject(others, &String.contains?(text, "MSG: " <> &1))

    Enum.join(
      [text | for(name <- missing, do: "MSG: #{name}\n" <> elem(Library.fetch(name), 1))],
      "\n" <> String.duplicate("=", 80) <> "\n"
    )
  end

  @doc "A message's bytes. Error: `:not_writable`."
  @spec encode(%__MODULE__{}, term(), Situ.Time.t()) :: {:ok, binary()} | {:error, Error.t()}
  def encode(%{encoding: :json} = channel, data, _time) do
    {:ok, data |> Value.plain() |> object() |> Situ.JSON.encode()}
  catch
    {:not_writable, what} ->
      {:error, not_writable(channel, "#{inspect(what, limit: 5)} is nothing that JSON has")}
  end

  def encode(channel, data, time) do
    message = Standard.to(channel.definition.name, data, time)

    with {:error, why} <- Wire.encode(channel.definition, message, channel.encoding),
         do: {:error, not_writable(channel, why)}
  end

  # Tools want objects: what is none gets a member of its own.
  defp object({_} = object), do: object
  defp object(value), do: {[{"value", value}]}

  defp not_writable(channel, why),
    do: Error.new(:not_writable, "a message of #{channel.topic} cannot be written", why: why)
end

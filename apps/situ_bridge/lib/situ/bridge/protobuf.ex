defmodule Situ.Bridge.Protobuf do
  @moduledoc """
  Encodes and decodes Protobuf messages of any type as maps. The definition is the text of a `.proto` file or the
  bytes of a FileDescriptorSet (`protoc --descriptor_set_out=... --include_imports`; MCAP files have one for each
  channel).

      iex> alias Situ.Bridge.Protobuf
      iex> text = ~s(syntax = "proto3"; message Reading { string name = 1; repeated float levels = 2; })
      iex> {:ok, schema} = Protobuf.parse_schema(text)
      iex> {:ok, bytes} = Protobuf.encode(schema, "Reading", %{"name" => "a", "levels" => [0.5, 1.5]})
      iex> Protobuf.decode(schema, "Reading", bytes)
      {:ok, %{"name" => "a", "levels" => [0.5, 1.5]}}

  Keys are the names of the fields. Enumerations are the names of their values (or numbers, if a value has no name),
  bytes are binaries, messages and `map<...>` are maps, `google.protobuf.Timestamp` and `Duration` are nanoseconds,
  and NaN and infinities are atoms. A field that is missing from the bytes is zero, empty, or `nil` if Protobuf
  distinguishes absent fields. Fields that are not in the definition are dropped, as are groups. Foxglove's messages
  (`foxglove.CompressedImage` ...) and Google's time types are available to every definition.

  Malformed input returns an error. Decoding creates no atoms, is limited to 100 levels of nesting, and is bounded by
  the size of the input.
  """
  # The wire format has four kinds of fields. Reader, writer, descriptors and the parser of
  # `.proto` texts take about 800 lines without dependencies. The crate `prost-reflect` would
  # still require a conversion of every field to a term. The descriptors made from `priv/foxglove`
  # are the same as in the Foxglove package for all 48 messages.
  alias Situ.Bridge.Foxglove.Messages
  alias Situ.Bridge.Protobuf.{Descriptor, Reader, Schema, ProtoParser, Writer}
  alias Situ.Error

  @type schema :: Schema.t()

  @doc "Parses a definition, either text or a FileDescriptorSet. Error: `:bad_definition`."
  @spec parse_schema(binary()) :: {:ok, schema()} | {:error, Error.t()}
  def parse_schema(definition) do
    with {:error, why} <- read_definition(definition) do
      {:error,
       Error.new(:bad_definition, "the Protobuf definition cannot be used",
         why: why,
         fix:
           "pass the text of one .proto file, or a FileDescriptorSet made with --include_imports"
       )}
    end
  end

  # A FileDescriptorSet begins with field 1, whose byte is a line feed; a text may also begin with a line feed.
  defp read_definition(<<10, _::binary>> = bytes) do
    case Descriptor.parse_set(bytes) do
      {:ok, %Schema{messages: messages} = schema} when messages != %{} ->
        {:ok, schema}

      {_, problem} ->
        with {:error, _} <- parse_text(bytes), do: {:error, explain_problem(problem)}
    end
  end

  defp read_definition(text), do: parse_text(text)

  defp parse_text(text),
    do: ProtoParser.parse(text, [Messages.load_types(), Descriptor.google_types()])

  defp explain_problem(why) when is_binary(why), do: why
  defp explain_problem(_empty), do: "it has no messages"

  @doc "Decodes a message of the type `name` (`\"package.Message\"`). Errors: `:no_such_type`, `:bad_message`."
  @spec decode(schema(), String.t(), binary()) :: {:ok, map()} | {:error, Error.t()}
  def decode(schema, name, bytes) do
    with :ok <- check_type(schema, name),
         {:error, why} <- Reader.decode(schema, name, bytes) do
      {:error,
       Error.new(:bad_message, "#{byte_size(bytes)} bytes are not a message of the type #{name}",
         why: why
       )}
    end
  end

  @doc "Encodes a message. Errors: `:no_such_type`, `:not_writable`."
  @spec encode(schema(), String.t(), map()) :: {:ok, binary()} | {:error, Error.t()}
  def encode(schema, name, message) do
    with :ok <- check_type(schema, name),
         {:error, why} <- Writer.encode(schema, name, message) do
      {:error,
       Error.new(:not_writable, "the message of the type #{name} cannot be encoded", why: why)}
    end
  end

  defp check_type(%Schema{messages: messages}, name) when is_map_key(messages, name), do: :ok

  defp check_type(%Schema{messages: messages}, name) do
    {:error,
     Error.new(:no_such_type, "the definition has no message #{inspect(name)}",
       fix:
         "use a type of the definition: #{messages |> Map.keys() |> Enum.sort() |> Enum.take(5) |> Enum.join(", ")} ..."
     )}
  end
end

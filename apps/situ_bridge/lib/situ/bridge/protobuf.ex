defmodule Situ.Bridge.Protobuf do
  @moduledoc """
  Protobuf messages of any type as maps, and back: by a definition, the text of a `.proto` file or the bytes of a
  FileDescriptorSet (`protoc --descriptor_set_out=... --include_imports`; MCAP files carry one for each channel).

      iex> alias Situ.Bridge.Protobuf
      iex> text = ~s(syntax = "proto3"; message Reading { string name = 1; repeated float levels = 2; })
      iex> {:ok, schema} = Protobuf.schema(text)
      iex> {:ok, bytes} = Protobuf.encode(schema, "Reading", %{"name" => "a", "levels" => [0.5, 1.5]})
      iex> Protobuf.decode(schema, "Reading", bytes)
      {:ok, %{"name" => "a", "levels" => [0.5, 1.5]}}

  Keys are the names of the fields. Enumerations are the names of their values (numbers, where there is none), bytes
  binaries, messages and `map<...>` maps, `google.protobuf.Timestamp` and `Duration` nanoseconds; NaN and infinities are
  atoms. A field that is not in the bytes is zero, empty, or `nil` where Protobuf tells the two apart. Fields that the
  definition has not are left out, groups too; Foxglove's messages (`foxglove.CompressedImage` ...) and Google's times
  are known to every definition.

  Hostile bytes are an error: reading makes no atoms, nests 100 deep at most, and is bounded by the bytes there are.
  """
  alias Situ.Bridge.Foxglove.Messages
  alias Situ.Bridge.Protobuf.{Descriptor, Reader, Schema, Text, Writer}
  alias Situ.Error

  @type schema :: Schema.t()

  @doc "The schema of a definition, text or FileDescriptorSet. Error: `:bad_definition`."
  @spec schema(binary()) :: {:ok, schema()} | {:error, Error.t()}
  def schema(definition) do
    with {:error, why} <- parsed(definition) do
      {:error,
       Error.new(:bad_definition, "the Protobuf definition cannot be used",
         why: why,
         fix:
           "give the text of one .proto file, or a FileDescriptorSet made with --include_imports"
       )}
    end
  end

  # A FileDescriptorSet begins with field 1, a line feed, as a text may.
  defp parsed(<<10, _::binary>> = bytes) do
    case Descriptor.read(bytes) do
      {:ok, %Schema{messages: messages} = schema} when messages != %{} -> {:ok, schema}
      {_, trouble} -> with {:error, _} <- text(bytes), do: {:error, trouble(trouble)}
    end
  end

  defp parsed(text), do: text(text)

  defp text(text), do: Text.parse(text, [Messages.types(), Descriptor.google()])

  defp trouble(why) when is_binary(why), do: why
  defp trouble(_empty), do: "it has no messages"

  @doc "A message of the type `name` (`\"package.Message\"`). Errors: `:no_such_type`, `:bad_message`."
  @spec decode(schema(), String.t(), binary()) :: {:ok, map()} | {:error, Error.t()}
  def decode(schema, name, bytes) do
    with :ok <- known(schema, name),
         {:error, why} <- Reader.decode(schema, name, bytes) do
      {:error,
       Error.new(:bad_message, "#{byte_size(bytes)} bytes are no message #{name}", why: why)}
    end
  end

  @doc "The bytes of a message. Errors: `:no_such_type`, `:not_writable`."
  @spec encode(schema(), String.t(), map()) :: {:ok, binary()} | {:error, Error.t()}
  def encode(schema, name, message) do
    with :ok <- known(schema, name),
         {:error, why} <- Writer.encode(schema, name, message) do
      {:error, Error.new(:not_writable, "a message #{name} cannot be written", why: why)}
    end
  end

  defp known(%Schema{messages: messages}, name) when is_map_key(messages, name), do: :ok

  defp known(%Schema{messages: messages}, name) do
    {:error,
     Error.new(:no_such_type, "the definition has no message #{inspect(name)}",
       fix:
         "name one of them: #{messages |> Map.keys() |> Enum.sort() |> Enum.take(5) |> Enum.join(", ")} ..."
     )}
  end
end

defmodule Situ.CLI.Store.Protobuf do
  @moduledoc false
  # The options for Protobuf files, whose messages can only be decoded with their definition.
  alias Situ.Bridge.Protobuf
  alias Situ.CLI.Option
  alias Situ.Error

  @doc "Returns the options of verbs that read or write Protobuf files."
  @spec file_options() :: [Option.t()]
  def file_options do
    [
      Option.new(:type, :string, "Protobuf: the type of the messages", value: "PACKAGE.MESSAGE"),
      Option.new(
        :definition,
        :path,
        "Protobuf: the .proto file or FileDescriptorSet (default: FILE.desc, else Foxglove's messages)",
        value: "FILE"
      ),
      Option.new(
        :time,
        :string,
        "Protobuf: the field with the originating time, for example header.stamp",
        value: "FIELD"
      )
    ]
  end

  @doc "Returns these options and `every:`, for files whose messages have no time."
  @spec read_options() :: [Option.t()]
  def read_options do
    file_options() ++
      [Option.new(:every, :span, "Protobuf: the interval between messages that have no time")]
  end

  @doc "Converts the verb's options to options of `Situ.Bridge.Protobuf.File`."
  @spec parse_options(keyword()) :: keyword()
  def parse_options(opts) do
    unless opts[:type],
      do: throw({:usage, "the type of the messages is missing: give --type PACKAGE.MESSAGE"})

    definition = if path = opts[:definition], do: read_definition!(path)

    for {name, value} <- [definition: definition] ++ Keyword.take(opts, [:type, :time, :every]),
        value != nil,
        do: {name, value}
  end

  defp read_definition!(path) do
    case File.read(path) do
      {:ok, text} ->
        text

      {:error, reason} ->
        raise Error.new(:io, "cannot read #{path}",
                why: to_string(:file.format_error(reason)),
                fix: "--definition needs a .proto file, or the output of `protoc -o`"
              )
    end
  end

  @doc "Writes a stream's messages to a file; `reading` has the options of `Situ.Store.messages/3`."
  @spec save_stream(
          Situ.Store.t(),
          Situ.Store.StreamInfo.t(),
          Path.t(),
          keyword(),
          {keyword(), function()}
        ) ::
          %{messages: non_neg_integer(), stream: String.t()}
  def save_stream(store, info, file, opts, {reading, progress}) do
    messages = Situ.Store.messages(store, info.name, reading)
    report_progress = &progress.(&1, info.count)

    n =
      Error.unwrap!(
        Protobuf.File.save(messages, file, [progress: report_progress] ++ parse_options(opts))
      )

    %{messages: n, stream: info.name}
  end
end

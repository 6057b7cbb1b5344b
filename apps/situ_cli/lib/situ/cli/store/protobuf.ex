defmodule Situ.CLI.Store.Protobuf do
  @moduledoc false
  # The options of Protobuf files, whose messages mean something by their definition only.
  alias Situ.Bridge.Protobuf
  alias Situ.CLI.Option
  alias Situ.Error

  @doc "For the verbs that write such files, and for those that read them."
  @spec options() :: [Option.t()]
  def options do
    [
      Option.new(:type, :string, "Protobuf: the messages' type", value: "PACKAGE.MESSAGE"),
      Option.new(
        :definition,
        :path,
        "Protobuf: its .proto or FileDescriptorSet (default: FILE.desc, else Foxglove's messages)",
        value: "FILE"
      ),
      Option.new(:time, :string, "Protobuf: the field with the originating time, as header.stamp",
        value: "FIELD"
      )
    ]
  end

  @doc "`every:` for files whose messages have no time."
  @spec reading() :: [Option.t()]
  def reading do
    options() ++
      [Option.new(:every, :span, "Protobuf, for messages without a time: from one to the next")]
  end

  @doc "The options of `Situ.Bridge.Protobuf.File` by those of the verb."
  @spec given(keyword()) :: keyword()
  def given(opts) do
    unless opts[:type],
      do: throw({:usage, "of which type are the messages? Give --type PACKAGE.MESSAGE"})

    definition = if path = opts[:definition], do: read!(path)

    for {name, value} <- [definition: definition] ++ Keyword.take(opts, [:type, :time, :every]),
        value != nil,
        do: {name, value}
  end

  defp read!(path) do
    case File.read(path) do
      {:ok, text} ->
        text

      {:error, reason} ->
        raise Error.new(:io, "cannot read #{path}",
                why: to_string(:file.format_error(reason)),
                fix: "--definition names a .proto file, or one that `protoc -o` has made"
              )
    end
  end

  @doc "Writes a stream's messages, `reading` of it as for `Situ.Store.messages/3`."
  @spec save(
          Situ.Store.t(),
          Situ.Store.StreamInfo.t(),
          Path.t(),
          keyword(),
          {keyword(), function()}
        ) ::
          %{messages: non_neg_integer(), stream: String.t()}
  def save(store, info, file, opts, {reading, progress}) do
    messages = Situ.Store.messages(store, info.name, reading)
    told = &progress.(&1, info.count)
    n = Error.unwrap!(Protobuf.File.save(messages, file, [progress: told] ++ given(opts)))
    %{messages: n, stream: info.name}
  end
end

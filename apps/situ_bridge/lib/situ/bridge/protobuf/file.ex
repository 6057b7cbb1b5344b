defmodule Situ.Bridge.Protobuf.File do
  @moduledoc """
  Reads and writes files of Protobuf messages, each preceded by its length as a varint. `writeDelimitedTo` of Java and
  C++ and `google.protobuf.proto.serialize_length_prefixed` of Python write the same format.

      definition = ~s(syntax = "proto3"; package lab; message Level { int64 time = 1; double volts = 2; })
      Situ.Bridge.Protobuf.File.write(levels, "levels.pb", type: "lab.Level", definition: definition)
      levels = Situ.Bridge.Protobuf.File.read(p, "levels.pb", type: "lab.Level")

  Messages are maps (`Situ.Bridge.Protobuf`); Foxglove's messages are Situ's types (`Situ.Bridge.Foxglove`). The
  option `time:` names the field with the originating time, which a writer fills in. A writer also saves the
  definition next to the file as `PATH.desc`, a FileDescriptorSet for `protoc --decode` and other readers. Files may
  have any length. If a file is truncated, its complete messages are returned before the error `:bad_file` is raised.
  """

  alias Situ.Bridge.Foxglove.{Messages, StandardTypes}
  alias Situ.Bridge.Protobuf
  alias Situ.Bridge.Protobuf.{Delimited, Descriptor, Stamp}
  alias Situ.Error

  @common [
    type: [type: :string, required: true, doc: "The type of the messages, `\"package.Message\"`."],
    definition: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The text of a `.proto` file, or a FileDescriptorSet; default: the file `PATH.desc`, or Foxglove's messages."
    ],
    time: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The field with the originating time, a Timestamp or an integer (ns), such as `\"header.stamp\"`. The " <>
          "default is the first of `timestamp`, `time`, `stamp`, `originating_time` and `header.stamp` that exists."
    ]
  ]
  @write [path: [type: :string, required: true, doc: "The file; an existing file is replaced."]] ++
           @common
  @read @common ++
          [
            every: [
              type: {:optional, :pos_integer},
              default: nil,
              doc: "For messages without a time: the interval between messages, ns."
            ],
            start: [
              type: :integer,
              default: 0,
              doc: "With `every:`, the time of the first message, ns."
            ],
            messages: [
              type: {:in, [:situ, :maps]},
              default: :situ,
              doc:
                "`:situ` converts Foxglove's messages to Situ's types; `:maps` returns all messages as maps."
            ]
          ]

  use Situ.Component, inputs: [in: :any]

  @chunk 65_536
  @progress_interval 1_000

  @impl true
  def options, do: @write

  @doc """
  Writes a stream to a file; returns the stream. Pipeline errors: `:no_such_type`, `:no_time`.

  #{Situ.Options.docs(Keyword.delete(@write, :path))}
  """
  @spec write(Situ.Stream.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def write(stream, path, opts) do
    Situ.via(stream, __MODULE__, [path: path] ++ opts)
    stream
  end

  @doc """
  Writes messages to a file and returns their number. The file and its definition get their final names only when they
  are complete. Takes the options of `write/3`, and `progress:`, a function that is called with the number of messages
  written so far. Errors: `:no_such_type`, `:no_time`, `:not_writable`, `:io`.
  """
  @spec save(Enumerable.t(Situ.Message.t()), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def save(messages, path, opts) do
    {progress, opts} = Keyword.pop(opts, :progress, fn _ -> :ok end)
    temporary = path <> ".unfinished"
    {:ok, state} = init(Situ.Options.validate!([path: temporary] ++ opts, @write))
    {[], state} = handle_start(nil, state)

    {state, n} =
      Enum.reduce(messages, {state, 0}, fn message, {state, n} ->
        {[], state} = handle_message(:in, message, nil, state)
        if rem(n + 1, @progress_interval) == 0, do: progress.(n + 1)
        {state, n + 1}
      end)

    close_file(state)
    for suffix <- [".desc", ""], do: rename_file!(temporary <> suffix, path <> suffix)
    {:ok, n}
  rescue
    error in Error ->
      for suffix <- [".desc", ""], do: File.rm(path <> ".unfinished" <> suffix)
      {:error, error}
  end

  defp rename_file!(temporary, path),
    do:
      with(
        {:error, reason} <- File.rename(temporary, path),
        do: raise(Delimited.io_error(path, reason))
      )

  @doc """
  Adds a source of a file's messages with their times; it proposes a replay from the first message on. A file without
  messages is an error, `:empty_file`.

  #{Situ.Options.docs(@read)}
  """
  @spec read(Situ.Pipeline.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def read(p, path, opts), do: Situ.Bridge.File.replay_source(p, messages(path, opts), path)

  @doc "Same as `write/3`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, path, opts), do: write(stream, path, opts)

  @doc "Same as `read/3`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def source(p, path, opts), do: read(p, path, opts)

  @doc """
  Returns the messages of a file as a lazy enumerable of `{time, value}`. Raises `Situ.Error` immediately for an invalid
  definition (`:bad_definition`, `:no_such_type`, `:no_time`), and during enumeration: `:io`, `:bad_file`.
  """
  @spec messages(Path.t(), keyword()) :: Enumerable.t()
  def messages(path, opts) do
    opts = Situ.Options.validate!(opts, @read)
    schema = load_schema!(path, opts)
    stamp = if opts[:every], do: nil, else: Stamp.find_field!(schema, opts[:type], opts[:time])

    path
    |> Delimited.stream_payloads()
    |> Stream.with_index()
    |> Stream.map(fn {{at, bytes}, n} ->
      case Protobuf.Reader.decode(schema, opts[:type], bytes) do
        {:ok, message} -> {message_time(message, stamp, n, opts), convert_value(message, opts)}
        {:error, why} -> raise Delimited.bad_file_error(path, at, why)
      end
    end)
  end

  defp message_time(_message, nil, n, opts), do: opts[:start] + n * opts[:every]
  defp message_time(message, stamp, _n, _opts), do: Stamp.get_time(message, stamp)

  defp convert_value(message, opts) do
    if opts[:messages] == :maps,
      do: message,
      else: StandardTypes.from_message(opts[:type], message)
  end

  defp load_schema!(path, opts) do
    definition_path = path <> ".desc"

    schema =
      cond do
        opts[:definition] ->
          Error.unwrap!(Protobuf.parse_schema(opts[:definition]))

        File.regular?(definition_path) ->
          definition_path |> File.read!() |> Protobuf.parse_schema() |> Error.unwrap!()

        true ->
          Messages.load_schema()
      end

    # Decoding an unknown type returns an error that lists the existing types.
    if not is_map_key(schema.messages, opts[:type]),
      do: Error.unwrap!(Protobuf.decode(schema, opts[:type], ""))

    schema
  end

  @impl true
  def init(opts), do: {:ok, %{opts: opts, file: nil, schema: nil, stamp: nil}}

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    # An existing definition at the path belongs to another file, so the path is not used here.
    schema = load_schema!("", opts)
    stamp = Stamp.find_field!(schema, opts[:type], opts[:time])

    with :ok <- File.write(opts[:path] <> ".desc", Descriptor.encode_set(schema, opts[:type])),
         {:ok, file} <-
           :file.open(opts[:path], [:write, :raw, :binary, {:delayed_write, @chunk, 1_000}]) do
      {[], %{state | file: file, schema: schema, stamp: stamp}}
    else
      {:error, reason} -> raise Delimited.io_error(opts[:path], reason)
    end
  end

  @impl true
  def handle_message(:in, message, _context, %{opts: opts} = state) do
    time = message.originating_time
    data = StandardTypes.to_message(opts[:type], message.data, time)

    if not is_map(data), do: raise(not_writable_error(opts, "its data are not a map"))

    case Protobuf.Writer.encode(
           state.schema,
           opts[:type],
           Stamp.put_time(data, state.stamp, time)
         ) do
      {:ok, bytes} -> append_bytes(state, Delimited.encode_frame(bytes))
      {:error, why} -> raise not_writable_error(opts, why)
    end

    {[], state}
  end

  defp not_writable_error(opts, why),
    do: Error.new(:not_writable, "cannot write a message as #{opts[:type]}", why: why)

  defp append_bytes(state, bytes) do
    with {:error, reason} <- :file.write(state.file, bytes),
         do: raise(Delimited.io_error(state.opts[:path], reason))
  end

  @impl true
  def handle_closed(:in, _time, _context, state), do: {[], close_file(state)}

  @impl true
  def terminate(_reason, state), do: close_file(state)

  defp close_file(%{file: nil} = state), do: state

  defp close_file(state) do
    with {:error, reason} <- :file.close(state.file),
         do: raise(Delimited.io_error(state.opts[:path], reason))

    %{state | file: nil}
  end
end

defmodule Situ.Bridge.File do
  @moduledoc """
  Writes streams to files that other programs read, and reads such files: JSON, JSON lines, CSV, MessagePack
  (`Situ.Bridge.Format`).

      Situ.Bridge.File.write(stream, "levels.csv", format: :csv)
      p |> Situ.Bridge.File.read("levels.json", format: :json) |> Situ.each(&IO.inspect/1)

  Files are written and read in chunks, so they may be of any length. The end of a file is written when the stream
  closes; if the writer is killed, the messages written so far can still be read. Named pipes work, too.
  """

  alias Situ.Bridge.Format
  alias Situ.Error

  @formats [:json, :json_lines, :csv, :message_pack, :situ]
  @write [
    path: [type: :string, required: true, doc: "The file path; an existing file is replaced."],
    format: [type: {:in, @formats}, required: true, doc: "A format of `Situ.Bridge.Format`."]
  ]
  @read [
    format: [type: {:in, @formats}, required: true, doc: "A format of `Situ.Bridge.Format`."],
    objects: [
      type: {:in, [:maps, :pairs]},
      default: :maps,
      doc: "Whether objects are read as maps or as ordered pairs; see `Situ.Bridge.Format`."
    ],
    type: [type: :any, default: :any, doc: "The type of the stream."],
    name: [type: :string, doc: "The component's name."]
  ]

  use Situ.Component, inputs: [in: :any]
  require Logger

  @chunk_bytes 65_536

  @impl true
  def options, do: @write

  @doc """
  Writes a stream to a file; returns the stream.

  #{Situ.Options.docs(Keyword.delete(@write, :path))}
  """
  @spec write(Situ.Stream.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def write(stream, path, opts) do
    Situ.via(stream, __MODULE__, [path: path] ++ opts)
    stream
  end

  @doc """
  Adds a source with the messages of a file and their times; it proposes a replay that starts at the first message. A
  file without messages is an error, `:empty_file`.

  #{Situ.Options.docs(@read)}
  """
  @spec read(Situ.Pipeline.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def read(p, path, opts) do
    opts = Situ.Options.validate!(opts, @read)
    messages = messages(path, opts[:format], Keyword.take(opts, [:objects]))
    replay_source(p, messages, path, Keyword.take(opts, [:type, :name]))
  end

  @doc false
  # Adds a source of `{time, value}` that starts at the first message.
  @spec replay_source(Situ.Pipeline.t(), Enumerable.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def replay_source(p, messages, path, opts \\ []) do
    case Enum.take(messages, 1) do
      [{first, _}] ->
        Situ.from_enumerable(p, messages, [start: first] ++ opts)

      [] ->
        raise Error.new(:empty_file, "#{path} has no messages",
                fix: "check that the program that writes the file wrote to it"
              )
    end
  end

  @doc "Same as `write/3`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, path, opts), do: write(stream, path, opts)

  @doc "Same as `read/3`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def source(p, path, opts), do: read(p, path, opts)

  @doc """
  Returns the messages of a file as a lazy enumerable of `{time, value}`. Enumerating it may raise `Situ.Error`
  (`:io`, `:bad_file`).
  """
  @spec messages(Path.t(), Format.name(), keyword()) :: Enumerable.t()
  def messages(path, format, opts \\ []) do
    module = Format.fetch_module!(format)

    Stream.resource(
      fn -> {open_file!(path), {"", module.start()}, 0} end,
      fn acc -> next_messages(acc, module, path, opts) end,
      fn {file, _, _} -> file && :file.close(file) end
    )
  end

  defp open_file!(path) do
    case :file.open(path, [:read, :raw, :binary, :read_ahead]) do
      {:ok, file} -> file
      {:error, reason} -> raise open_error(path, reason)
    end
  end

  defp open_error(path, reason),
    do: Error.new(:io, "cannot open #{path}", why: to_string(:file.format_error(reason)))

  defp next_messages({nil, _, _} = acc, _module, _path, _opts), do: {:halt, acc}

  defp next_messages({file, {rest, state}, at}, module, path, opts) do
    case :file.read(file, @chunk_bytes) do
      {:ok, bytes} ->
        emit_messages(
          module.split(rest <> bytes, state, false, opts),
          file,
          at + byte_size(bytes),
          path
        )

      :eof ->
        file |> emit_last_messages(module.split(rest, state, true, opts), at, path)

      {:error, reason} ->
        raise open_error(path, reason)
    end
  end

  defp emit_messages({:ok, messages, rest}, file, at, _path), do: {messages, {file, rest, at}}
  defp emit_messages({:error, why}, _file, at, path), do: raise(bad_file_error(path, at, why))

  defp emit_last_messages(file, {:ok, messages, _rest}, at, _path) do
    :file.close(file)
    {messages, {nil, nil, at}}
  end

  defp emit_last_messages(_file, {:error, why}, at, path),
    do: raise(bad_file_error(path, at, why))

  defp bad_file_error(path, at, why) do
    Error.new(:bad_file, "#{path} cannot be read",
      why: "#{why} (before byte #{at})",
      fix: "check that the file has the given format"
    )
  end

  # Writing

  @impl true
  def init(opts),
    do:
      {:ok,
       %{
         path: opts[:path],
         module: Format.fetch_module!(opts[:format]),
         format: opts[:format],
         file: nil,
         position: 0
       }}

  @impl true
  def handle_start(_context, state) do
    case :file.open(state.path, [:write, :raw, :binary, {:delayed_write, @chunk_bytes, 1_000}]) do
      {:ok, file} -> {[], %{state | file: file}}
      {:error, reason} -> raise open_error(state.path, reason)
    end
  end

  @impl true
  def handle_message(:in, message, _context, state) do
    {record, position} = encode_record(state, message)
    if state.position == 0 and state.format == :csv, do: warn_of_omitted(message.data, state.path)
    append_bytes(state, record)
    {[], %{state | position: position}}
  end

  defp encode_record(state, message) do
    Format.encode_record(state.module, message.data, message.originating_time, state.position)
  catch
    {:not_writable, what} -> raise Format.not_writable_error(state.format, what)
  end

  defp warn_of_omitted(value, path) do
    case Format.Csv.list_omitted(value) do
      [] ->
        :ok

      names ->
        Logger.warning(
          "#{path} has no columns for the lists #{Enum.join(names, ", ")}: CSV of a stream omits them. " <>
            "Write JSON lines, or save a recording with `situ store save`."
        )
    end
  end

  @impl true
  def handle_closed(:in, _time, _context, state) do
    append_bytes(state, state.module.finish(state.position))
    {[], close_file(state)}
  end

  @impl true
  def terminate(_reason, state), do: close_file(state)

  defp append_bytes(state, bytes) do
    with {:error, reason} <- :file.write(state.file, bytes) do
      raise Error.new(:io, "cannot write to #{state.path}",
              why: to_string(:file.format_error(reason))
            )
    end
  end

  defp close_file(%{file: nil} = state), do: state

  defp close_file(state) do
    result = :file.close(state.file)

    if result == {:error, :enospc},
      do: raise(Error.new(:disk_full, "no space left on the disk of #{state.path}"))

    %{state | file: nil}
  end
end

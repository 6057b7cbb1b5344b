defmodule Situ.Store.Transfer do
  @moduledoc false
  # Copies a stream of other stores unchanged into a new store. Type, metadata, codecs and payloads are copied as bytes,
  # which includes terms whose modules or atoms this system does not have. Signals whose codec computes their pyramid
  # are copied as messages, and so are external files, unless their reader appends its messages itself.
  alias Situ.Error

  alias Situ.Recording

  alias Situ.Store.{
    Codecs,
    NativeErrors,
    NativeFormat,
    Native,
    Query,
    SegmentedRecording,
    StreamInfo,
    TypeName,
    Writer
  }

  alias Situ.Store.S3.Mirror

  @enforce_keys [:stream, :raw?, :numbers, :skip_damage, :report_progress]
  defstruct @enforce_keys

  @type source :: {Recording.t(), StreamInfo.t()}
  @type t :: %__MODULE__{}

  @part_bytes 4 * 1024 * 1024

  @doc """
  Creates the new stream, described by `info`, for the messages of `sources`. Calls `report_progress.(n)` for every `n`
  messages.
  """
  @spec open_stream(Writer.t(), StreamInfo.t(), [source()], keyword(), (pos_integer() -> any())) ::
          {:ok, t()} | {:error, Error.t()}
  def open_stream(writer, info, sources, opts, report_progress) do
    stored = Enum.flat_map(sources, &stored_streams/1)
    open_stored(writer, info, if(stored == [], do: sources, else: stored), opts, report_progress)
  end

  # A segmented recording is copied segment by segment.
  defp stored_streams({%{module: SegmentedRecording} = store, info}) do
    for part <- SegmentedRecording.list_parts(store.state, info),
        do: {%Recording{path: store.path, module: NativeFormat, state: nil}, part.info}
  end

  defp stored_streams(source), do: [source]

  defp open_stored(writer, info, sources, opts, report_progress) do
    record = %{
      type: stored_type(info, sources),
      opened: info.opened || Situ.Time.now(),
      large: info.large?,
      compression: opts[:compression] || info.compression
    }

    with {:ok, stream} <- Writer.add_recorded_stream(writer, info.name, record) do
      transfer = %__MODULE__{
        stream: stream,
        raw?: Enum.all?(sources, &raw_copy?/1),
        numbers: %{},
        skip_damage: Keyword.get(opts, :skip_damage, true),
        report_progress: report_progress
      }

      write_catalog(transfer, Enum.map(sources, &elem(&1, 1)))
    end
  end

  @doc "Copies a source's messages up to time `to` into a stream without messages, and returns the stream."
  @spec continue_stream(Writer.Stream.t(), source(), Situ.Time.t()) ::
          {:ok, Writer.Stream.t()} | {:error, Error.t()}
  def continue_stream(stream, {_, info} = source, to) do
    transfer = %__MODULE__{
      stream: stream,
      raw?: raw_copy?(source),
      numbers: %{},
      skip_damage: true,
      report_progress: fn _n -> :ok end
    }

    with {:ok, transfer} <- write_catalog(transfer, [info]),
         {:ok, transfer, _next} <- transfer_messages(transfer, source, 0, to),
         do: {:ok, transfer.stream}
  end

  defp stored_type(info, [{%{module: NativeFormat}, _} | _]), do: info.type_name
  defp stored_type(info, _), do: TypeName.format_type(info.type)

  defp raw_copy?({%{module: NativeFormat}, info}),
    do:
      not Enum.any?(info.codecs, fn {_, {name, module}} ->
        signal_codec?(Codecs.find_module(name, module))
      end)

  defp raw_copy?(_foreign), do: false

  defp signal_codec?(module), do: module != nil and function_exported?(module, :points, 2)

  # Writes the remaining catalog records about the stream.
  defp write_catalog(transfer, infos) do
    with :ok <- note_metadata(transfer, Enum.find_value(infos, & &1.supplemental)) do
      if transfer.raw?, do: note_payload(transfer, infos), else: {:ok, transfer}
    end
  end

  defp note_metadata(_transfer, nil), do: :ok

  defp note_metadata(transfer, {type, bytes}) do
    record = %{kind: "metadata", type: type, term: Base.encode64(bytes)}
    with {:ok, _} <- write_record(transfer, record), do: :ok
  end

  defp note_payload(transfer, infos) do
    codecs = infos |> Enum.flat_map(&Map.values(&1.codecs)) |> Enum.uniq() |> Enum.with_index(1)
    shaped = Enum.find(infos, & &1.fields)

    fields =
      if shaped, do: [%{kind: "fields", module: shaped.module, fields: shaped.fields}], else: []

    records = for({{name, module}, n} <- codecs, do: codec_record(name, module, n)) ++ fields

    modules =
      for {{name, module}, n} <- codecs, found = Codecs.find_module(name, module), do: {found, n}

    stream = %{transfer.stream | codecs: Map.new(modules), fields: shaped && shaped.fields}

    Enum.reduce_while(records, {:ok, %{transfer | stream: stream, numbers: Map.new(codecs)}}, fn
      record, ok ->
        case write_record(transfer, record) do
          {:ok, _} -> {:cont, ok}
          error -> {:halt, error}
        end
    end)
  end

  defp codec_record(name, nil, n), do: %{kind: "codec", number: n, name: name}
  defp codec_record(name, module, n), do: %{kind: "codec", number: n, name: name, module: module}

  defp write_record(%{stream: stream}, record),
    do: Writer.append_catalog(stream.writer, Map.put(record, :id, stream.id))

  @doc "Copies a source's messages from an ordinal on, up to time `to`, and returns the next ordinal."
  @spec transfer_messages(t(), source(), non_neg_integer(), Situ.Time.t() | :unbounded) ::
          {:ok, t(), non_neg_integer()} | {:error, Error.t()}
  def transfer_messages(transfer, {%{module: SegmentedRecording} = store, info}, ordinal, to) do
    store.state
    |> SegmentedRecording.list_parts(info)
    |> Enum.reduce_while({:ok, transfer, ordinal}, fn part, {:ok, transfer, ordinal} ->
      case transfer_part(transfer, {store.state, part}, ordinal, to) do
        {:ok, _, _} = ok -> {:cont, ok}
        error -> {:halt, error}
      end
    end)
  end

  def transfer_messages(%__MODULE__{raw?: false} = transfer, {store, info}, ordinal, to) do
    store
    |> Query.messages(info,
      index: ordinal,
      to: to,
      skip_damage: transfer.skip_damage,
      packets: true
    )
    |> Stream.chunk_every(1_000)
    |> Enum.reduce_while({:ok, transfer}, fn batch, {:ok, transfer} ->
      case append_messages(transfer, batch) do
        {:ok, _} = ok -> {:cont, ok}
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, transfer} -> next_ordinal(transfer, store, info, to)
      error -> error
    end
  rescue
    error in Error -> {:error, error}
  end

  def transfer_messages(
        %__MODULE__{stream: stream} = transfer,
        {store, info} = source,
        ordinal,
        to
      ) do
    numbers = for {number, codec} <- info.codecs, do: {number, transfer.numbers[codec]}
    target = {stream.id, numbers}

    copy = fn ->
      Native.store_transfer(
        store.state.ref,
        info.id,
        ordinal,
        NativeFormat.clamp_time(to),
        @part_bytes,
        stream.writer.ref,
        target
      )
    end

    case Mirror.with_bytes(store.state.path, copy) do
      {:ok, {0, ordinal}} ->
        {:ok, transfer, ordinal}

      {:ok, {n, next}} ->
        transfer.report_progress.(n)
        transfer_messages(transfer, source, next, to)

      {:error, reason} ->
        handle_failure(reason, transfer, source, ordinal, to)
    end
  end

  # A segment that `keep:` deletes during the copy is not copied.
  defp transfer_part(transfer, {state, part}, ordinal, to) do
    to = NativeFormat.clamp_time(to)
    to = if part.until, do: min(to, part.until - 1), else: to

    with true <- ordinal < part.base + part.count and part.info.first <= to,
         {:ok, store} <- SegmentedRecording.open_part(state, part),
         first = max(ordinal - part.base, 0),
         {:ok, transfer, next} <- transfer_messages(transfer, {store, part.info}, first, to) do
      {:ok, transfer, max(part.base + next, ordinal)}
    else
      none when none in [false, :deleted] -> {:ok, transfer, ordinal}
      error -> error
    end
  end

  @doc "Returns whether `transfer_together/2` supports this store."
  @spec one_pass?(Recording.t()) :: boolean()
  def one_pass?(store), do: Recording.implements?(store, :append_streams, 4)

  @doc "Copies the messages in an interval of several streams of one store."
  @spec transfer_together([{t(), source()}], {Situ.Time.t(), Situ.Time.t()}) ::
          :ok | {:error, Error.t()}
  def transfer_together([{%{report_progress: report_progress}, {store, _}} | _] = taken, interval) do
    targets = for {transfer, {_, info}} <- taken, do: {info, transfer.stream}
    store.module.append_streams(store.state, targets, interval, report_progress)
  end

  defp next_ordinal(transfer, _store, info, :unbounded), do: {:ok, transfer, info.count}

  defp next_ordinal(transfer, store, info, to) do
    with {:ok, ordinal} <- Query.seek_ordinal(store, info, to + 1),
         do: {:ok, transfer, ordinal}
  end

  # Unreadable messages are skipped if the caller allows it. Failed writes are always errors.
  defp handle_failure(reason, transfer, {store, info} = source, ordinal, to)
       when elem(reason, 0) in [:damaged, :missing_extent] do
    next = Native.reader_skip(store.state.ref, info.id, ordinal)

    if transfer.skip_damage and next != ordinal,
      do: transfer_messages(transfer, source, next, to),
      else: {:error, NativeErrors.to_error(reason, store.path, info.name)}
  end

  defp handle_failure(reason, %{stream: stream}, _source, _ordinal, _to),
    do: {:error, NativeErrors.to_error(reason, stream.writer.path, stream.name)}

  @doc "Appends other messages after the copied ones."
  @spec append_messages(t(), [Situ.Message.t()]) :: {:ok, t()} | {:error, Error.t()}
  def append_messages(transfer, messages) do
    with {:ok, stream} <- Writer.append(transfer.stream, messages) do
      transfer.report_progress.(length(messages))
      {:ok, %{transfer | stream: stream}}
    end
  end

  @doc "Closes the stream at this time, or leaves it open for `nil`."
  @spec close_stream(t(), Situ.Time.t() | nil) :: :ok | {:error, Error.t()}
  def close_stream(_transfer, nil), do: :ok

  def close_stream(transfer, time) do
    with {:ok, _} <- Writer.close_stream(transfer.stream, time), do: :ok
  end
end

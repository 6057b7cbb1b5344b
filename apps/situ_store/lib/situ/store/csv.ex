defmodule Situ.Store.Csv do
  @moduledoc """
  CSV files as recordings: a column of times, and one stream for every other column.

  Options (`Situ.Store.open(path, reader_opts: [...])`):

    * `time:` the name or number (0 is the first) of the time column; default: the first column called like a time,
      else the first
    * `unit:` `:auto` (default), `:s`, `:ms`, `:us`, `:ns` or `:iso8601`; `:auto` takes ISO 8601 as such, and numbers
      by the unit in the column's name (`t_ms`, `Timestamp (us)`), else as seconds
    * `start:` ns added to every time, default 0
    * `separator:` default: `,`, `;` or tab, whichever the first line has most of

  Fields are numbers where they look like numbers, else strings; a column is `:integer`, `:float` or `:string` as all
  its fields are. Empty fields are no message. Quotes are those of RFC 4180: a field in quotes may hold separators,
  quotes (doubled) and line breaks. Rows that do not go forward in time or cannot be read are left out and counted in
  `Situ.Store.info/1` as damage.

  The file may be of any length: opening passes over it once, and of every 1,000 rows only the place is kept; reading
  takes them from there. A copy into a store (`Situ.Store.copy/3`) reads all columns in one further pass.
  """
  @behaviour Situ.Store.Reader
  alias Situ.{Error, Message}
  alias Situ.Store.Csv.{Appending, Scan}
  alias Situ.Store.StreamInfo

  defstruct [:path, :size, :scan, :streams, :parts]

  @impl true
  def extensions, do: [".csv", ".tsv"]

  @impl true
  def open(path, opts) do
    with {:ok, %{type: :regular, size: size}} <- File.stat(path),
         {:ok, scan} <- Scan.run(path, opts) do
      streams = for {index, column} <- Enum.sort(scan.columns), do: stream(index, column, path)
      parts = scan.parts |> Enum.reverse() |> List.to_tuple()
      {:ok, %__MODULE__{path: path, size: size, scan: scan, streams: streams, parts: parts}}
    else
      {:ok, %{type: type}} ->
        {:error, Error.new(:io, "cannot read #{path}", why: "it is a #{type}, not a file")}

      {:error, reason} when is_atom(reason) ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}

      {:error, why} ->
        {:error, Error.new(:not_csv, "#{path} is not a CSV file Situ can read", why: why)}
    end
  end

  defp stream(index, column, path) do
    type = column.kind || :any

    %StreamInfo{
      id: index + 1,
      name: if(column.name == "", do: "Column#{index}", else: column.name),
      store_name: Path.basename(path, Path.extname(path)),
      store_path: path,
      type: type,
      type_name: inspect(type),
      count: column.count,
      first: column.first,
      last: column.last,
      first_creation: column.first,
      last_creation: column.last,
      closed: column.last
    }
  end

  @impl true
  def info(state) do
    name = Path.basename(state.path, Path.extname(state.path))
    damage = Enum.reverse(state.scan.damage)
    %{name: name, created: nil, closed?: true, live?: false, damage: damage}
  end

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time) do
    at = first_part(state, time)

    with {:ok, messages} <- part(state, info, at) do
      before = Enum.count(messages, &(&1.originating_time < time))
      {:ok, base(state, info, at) + before}
    end
  end

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    if ordinal >= info.count,
      do: {:ok, [], ordinal},
      else: read_part(state, info, ordinal, to, if(opts[:exact], do: limit, else: :all))
  end

  @impl true
  def append_streams(state, targets, {from, _to} = interval, told) do
    # A column without fields has no kind, and no messages.
    filled = for {%{count: count}, _stream} = target <- targets, count > 0, do: target

    job = %Appending{
      scan: state.scan,
      parts: state.parts,
      targets: filled,
      interval: interval,
      messages: &part(state, &1, &2),
      told: told
    }

    with {:error, why} when is_binary(why) <- Appending.append(job, first_part(state, from)),
         do: {:error, changed(state, why)}
  end

  # The rest of the part that holds the message: a part is what is read at once anyway.
  defp read_part(state, info, ordinal, to, most) do
    at = search(state.parts, &(Map.get(&1.counts, info.id - 1, 0) <= ordinal))

    with {:ok, messages} <- part(state, info, at) do
      case Enum.drop(messages, ordinal - base(state, info, at)) do
        [] ->
          {:error, changed(state)}

        messages ->
          messages = if most == :all, do: messages, else: Enum.take(messages, most)

          messages =
            if to == :unbounded,
              do: messages,
              else: Enum.take_while(messages, &(&1.originating_time <= to))

          {:ok, messages, ordinal + length(messages)}
      end
    end
  end

  # The last part that begins before `time`: what is wanted lies in it or is the first behind it.
  defp first_part(state, time), do: search(state.parts, &(&1.last == nil or &1.last < time))

  defp changed(state, why \\ nil),
    do: Error.new(:damaged, "#{state.path} has changed since it was opened", why: why)

  # The last part of which `before?` holds; it does of the first ones, and of none behind them.
  defp search(parts, before?), do: search(parts, before?, 0, tuple_size(parts))
  defp search(_parts, _before?, low, high) when high - low <= 1, do: low

  defp search(parts, before?, low, high) do
    middle = div(low + high, 2)

    if before?.(elem(parts, middle)),
      do: search(parts, before?, middle, high),
      else: search(parts, before?, low, middle)
  end

  defp base(%{parts: {}}, _info, _at), do: 0
  defp base(state, info, at), do: Map.get(elem(state.parts, at).counts, info.id - 1, 0)

  defp part(%{parts: {}}, _info, _at), do: {:ok, []}

  defp part(state, info, at) do
    part = elem(state.parts, at)

    case Scan.values(state.scan, part, info.id - 1) do
      {:ok, values} ->
        {:ok, messages(values, info.id, (part.counts[info.id - 1] || 0) + 1)}

      {:error, why} ->
        {:error, changed(state, why)}
    end
  end

  defp messages([], _source, _sequence), do: []

  defp messages([{time, value} | values], source, sequence) do
    message = %Message{
      data: value,
      originating_time: time,
      creation_time: time,
      sequence_id: sequence,
      source_id: source
    }

    [message | messages(values, source, sequence + 1)]
  end
end

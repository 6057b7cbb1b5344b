defmodule Situ.Store.Csv do
  @moduledoc """
  CSV files as recordings: a column of times, and one stream for every other column.

  Options (`Situ.Store.open(path, reader_opts: [...])`):

    * `time:` the name or number (0 is the first) of the time column; default: the first column called like a time, else the first
    * `unit:` `:auto` (default), `:s`, `:ms`, `:us`, `:ns` or `:iso8601`; `:auto` takes ISO 8601 as such, and numbers by the unit in
      the column's name (`t_ms`, `Timestamp (us)`), else as seconds
    * `start:` ns added to every time, default 0
    * `separator:` default: `,`, `;` or tab, whichever the first line has most of

  Fields are numbers where they look like numbers, else strings; empty fields are no message. Rows that do not go forward in time or cannot be read
  are left out and counted in `Situ.Store.info/1` as damage. The file is read into memory when it is opened (at most 512 MiB).
  """
  @behaviour Situ.Store.Reader
  alias Situ.{Error, Message}
  alias Situ.Store.StreamInfo

  @max_bytes 512 * 1024 * 1024
  @units %{s: 1_000_000_000, ms: 1_000_000, us: 1_000, ns: 1}

  defstruct [:path, :streams, :columns, :damage]

  @impl true
  def extensions, do: [".csv", ".tsv"]

  @impl true
  def open(path, opts) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path),
         {:ok, text} <- File.read(path),
         {:ok, separator, names, rows} <- table(text, opts),
         {:ok, column} <- time_column(names, opts[:time]),
         {:ok, unit} <- unit(Enum.at(names, column), rows, column, opts[:unit] || :auto, path) do
      build(path, names, rows, column, unit, opts[:start] || 0, separator)
    else
      {:ok, %{size: size}} ->
        {:error,
         Error.new(:too_large, "#{path} has #{size} bytes",
           why: "CSV is read whole; 512 MiB at most"
         )}

      {:error, reason} when is_atom(reason) ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}

      {:error, why} ->
        {:error, Error.new(:not_csv, "#{path} is not a CSV file Situ can read", why: why)}
    end
  end

  defp table(text, opts) do
    text = String.replace_prefix(text, "\uFEFF", "")

    with true <- String.valid?(text) || {:error, "it is not UTF-8 text"},
         [first | _] = lines when first != "" <- lines(text),
         separator = opts[:separator] || separator(first),
         [names | rows] = Enum.map(lines, &fields(&1, separator)),
         true <- length(names) > 1 || {:error, "its first line has one column only"} do
      # A first line of numbers is no heading.
      if Enum.all?(names, &is_number(value(&1))),
        do: {:ok, separator, Enum.map(0..(length(names) - 1), &"Column#{&1}"), [names | rows]},
        else: {:ok, separator, Enum.map(names, &String.trim/1), rows}
    else
      {:error, why} -> {:error, why}
      _ -> {:error, "it is empty"}
    end
  end

  defp lines(text), do: text |> String.split(["\r\n", "\n", "\r"]) |> Enum.reject(&(&1 == ""))

  defp separator(line) do
    Enum.max_by([",", ";", "\t"], fn mark ->
      line |> String.graphemes() |> Enum.count(&(&1 == mark))
    end)
  end

  defp fields(line, separator) do
    if String.contains?(line, "\""),
      do: quoted(line, separator, "", [], :plain),
      else: String.split(line, separator)
  end

  # RFC 4180 within one line: "" is a quote inside quotes.
  defp quoted("", _separator, field, fields, _), do: Enum.reverse([field | fields])

  defp quoted("\"\"" <> rest, s, field, fields, :quoted),
    do: quoted(rest, s, field <> "\"", fields, :quoted)

  defp quoted("\"" <> rest, s, field, fields, :quoted), do: quoted(rest, s, field, fields, :plain)
  defp quoted("\"" <> rest, s, field, fields, :plain), do: quoted(rest, s, field, fields, :quoted)

  defp quoted(<<char::utf8, rest::binary>>, s, field, fields, state) do
    if state == :plain and <<char::utf8>> == s,
      do: quoted(rest, s, "", [field | fields], :plain),
      else: quoted(rest, s, field <> <<char::utf8>>, fields, state)
  end

  defp time_column(names, nil) do
    guess = Enum.find_index(names, &(&1 =~ ~r/\A(t|time.*|timestamp.*|date.*|originating.*)\z/i))
    {:ok, guess || 0}
  end

  defp time_column(names, column) when is_integer(column) do
    if column in 0..(length(names) - 1),
      do: {:ok, column},
      else: {:error, "it has no column #{column}"}
  end

  defp time_column(names, name) do
    case Enum.find_index(names, &(&1 == name)) do
      nil -> {:error, "it has no column #{inspect(name)}; columns: #{Enum.join(names, ", ")}"}
      column -> {:ok, column}
    end
  end

  defp unit(name, rows, column, :auto, _path) do
    sample = Enum.find_value(rows, &Enum.at(&1, column))

    cond do
      sample == nil ->
        {:ok, :s}

      not is_number(value(sample)) ->
        {:ok, :iso8601}

      match = Regex.run(~r/(?:_|\(|\[|\s)(ns|us|µs|ms|s)\b/u, name) ->
        {:ok, suffix(List.last(match))}

      true ->
        {:ok, :s}
    end
  end

  defp unit(_name, _rows, _column, unit, _path)
       when unit in [:s, :ms, :us, :ns, :iso8601],
       do: {:ok, unit}

  defp unit(_, _, _, unit, _), do: {:error, "#{inspect(unit)} is no unit of time"}

  defp suffix("µs"), do: :us
  defp suffix("ns"), do: :ns
  defp suffix("us"), do: :us
  defp suffix("ms"), do: :ms
  defp suffix("s"), do: :s

  defp build(path, names, rows, column, unit, start, _separator) do
    width = length(names)

    {kept, damage, _} =
      rows
      |> Enum.with_index(2)
      |> Enum.reduce({[], [], nil}, fn {row, line}, {kept, damage, last} ->
        with true <- length(row) == width || "it has #{length(row)} fields, not #{width}",
             {:ok, time} <- time(Enum.at(row, column), unit),
             time = time + start,
             true <- last == nil or time > last || "its time does not go forward" do
          {[{time, row} | kept], damage, time}
        else
          why -> {kept, [{Path.basename(path), line, "line #{line}: #{why}"} | damage], last}
        end
      end)

    kept = Enum.reverse(kept)

    columns =
      for {name, index} <- Enum.with_index(names), index != column, into: %{} do
        values =
          for {time, row} <- kept,
              text = String.trim(Enum.at(row, index)),
              text != "",
              do: {time, value(text)}

        {index + 1, {name, values |> unify() |> List.to_tuple()}}
      end

    state = %__MODULE__{path: path, columns: columns, damage: Enum.reverse(damage)}
    {:ok, %{state | streams: columns |> Enum.sort() |> Enum.map(&stream(&1, path))}}
  end

  # One type for a column: integers among floats are floats, anything among strings a string.
  defp unify(values) do
    case values |> Enum.map(fn {_, v} -> kind(v) end) |> Enum.uniq() do
      [_] ->
        values

      kinds ->
        if :string in kinds,
          do: texts(values),
          else: Enum.map(values, fn {t, v} -> {t, v / 1} end)
    end
  end

  defp texts(values), do: Enum.map(values, fn {t, v} -> {t, to_string(v)} end)

  defp kind(v) when is_integer(v), do: :integer
  defp kind(v) when is_float(v), do: :float
  defp kind(_), do: :string

  defp stream({id, {name, values}}, path) do
    count = tuple_size(values)

    {first, last} =
      if count > 0, do: {elem(values, 0), elem(values, count - 1)}, else: {{nil, nil}, {nil, nil}}

    type = if count > 0, do: kind(elem(first, 1)), else: :any

    %StreamInfo{
      id: id,
      name: if(name == "", do: "Column#{id - 1}", else: name),
      store_name: Path.basename(path, Path.extname(path)),
      store_path: path,
      type: type,
      type_name: inspect(type),
      count: count,
      first: elem(first, 0),
      last: elem(last, 0),
      first_creation: elem(first, 0),
      last_creation: elem(last, 0),
      closed: elem(last, 0)
    }
  end

  defp time(text, :iso8601) do
    case Situ.Time.parse(String.trim(text)) do
      {:ok, time} -> {:ok, time}
      {:error, error} -> error.what
    end
  end

  defp time(text, unit) do
    case value(String.trim(text)) do
      n when is_integer(n) -> {:ok, n * @units[unit]}
      x when is_float(x) -> {:ok, round(x * @units[unit])}
      _ -> "#{inspect(text)} is no time"
    end
  end

  defp value(text) do
    text = String.trim(text)

    case Integer.parse(text) do
      {n, ""} -> n
      _ -> float(text)
    end
  end

  defp float(text) do
    case Float.parse(text) do
      {x, ""} -> x
      _ -> text
    end
  end

  @impl true
  def info(state) do
    name = Path.basename(state.path, Path.extname(state.path))
    %{name: name, created: nil, closed?: true, live?: false, damage: state.damage}
  end

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time) do
    {_, values} = Map.fetch!(state.columns, info.id)
    {:ok, search(values, time, 0, tuple_size(values))}
  end

  defp search(_values, _time, low, high) when low >= high, do: low

  defp search(values, time, low, high) do
    middle = div(low + high, 2)

    if elem(elem(values, middle), 0) < time,
      do: search(values, time, middle + 1, high),
      else: search(values, time, low, middle)
  end

  @impl true
  def read(state, info, ordinal, to, limit, _opts) do
    {_, values} = Map.fetch!(state.columns, info.id)
    last = min(tuple_size(values), ordinal + limit) - 1

    messages =
      for(at <- ordinal..last//1, do: {at, elem(values, at)})
      |> Enum.take_while(fn {_, {time, _}} -> to == :unbounded or time <= to end)
      |> Enum.map(fn {at, {time, value}} ->
        %Message{
          data: value,
          originating_time: time,
          creation_time: time,
          sequence_id: at + 1,
          source_id: info.id
        }
      end)

    {:ok, messages, ordinal + length(messages)}
  end
end

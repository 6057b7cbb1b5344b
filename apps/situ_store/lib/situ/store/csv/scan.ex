defmodule Situ.Store.Csv.Scan do
  @moduledoc false
  # Scans a CSV file once to find its columns and the position of every thousandth row.
  # An earlier reader held the whole file as terms, which limited it to half a gigabyte, and it
  # split lines before it looked at quotes. The scan keeps a few hundred bytes per thousand rows.
  # A row of more than 16 MiB is rejected, because an unclosed quote would take in the rest of the
  # file.
  alias Situ.Store.Csv.Field
  alias Situ.Store.{NativeErrors, Native, Writer}

  @rows 1_000
  @bytes 4 * 1024 * 1024
  @most_damage 10_000
  @native -0x8000000000000000..0x7FFFFFFFFFFFFFFF
  # Number of parts scanned per native call.
  @parts 32

  # columns: index => %{name, kind, count, first, last}. parts (latest first): %{place, last, counts} with the position
  # where the part begins, the last valid time before it, and the number of messages of each column before it.
  defstruct [:path, :separator, :width, :time, :unit, :start, columns: %{}, parts: [], damage: []]

  @type place :: {byte :: non_neg_integer(), line :: pos_integer()}
  @type row :: {line :: pos_integer(), [String.t()]}
  @type t :: %__MODULE__{}

  @spec scan_file(Path.t(), keyword()) :: {:ok, t()} | {:error, String.t()}
  def scan_file(path, opts) do
    with {:ok, start, line} <- first_line(path),
         {:ok, separator} <- resolve_separator(opts[:separator], line),
         scan = %__MODULE__{path: path, separator: separator, start: opts[:start] || 0},
         {:ok, [{_, names} = first], second} <- read_heading(scan, start),
         {:ok, next, _} <- read_rows(scan, second, 1),
         {:ok, names, rows_at, sample} <- column_names(names, first, start, second, next),
         {:ok, time} <- time_column(names, opts[:time]),
         {:ok, unit} <-
           Field.resolve_unit(
             Enum.at(names, time),
             sample && Enum.at(sample, time),
             opts[:unit] || :auto
           ) do
      columns =
        for {name, index} <- Enum.with_index(names),
            index != time,
            into: %{},
            do: {index, %{name: name, kind: nil, count: 0, first: nil, last: nil}}

      scan_parts(
        %{scan | width: length(names), time: time, unit: unit, columns: columns},
        rows_at,
        nil
      )
    end
  end

  @doc "Reads the rows of the part that begins at `place`."
  @spec read_rows(t(), place()) :: {:ok, [row()], place()} | {:error, String.t()}
  def read_rows(scan, place), do: read_rows(scan, place, @rows)

  defp read_rows(scan, {byte, line} = place, most) do
    case Native.csv_rows(scan.path, scan.separator, byte, line, most, @bytes) do
      {:ok, [], next} when next != place and elem(next, 0) > byte and most > 1 ->
        read_rows(scan, next, most)

      {:ok, rows, next} ->
        {:ok, rows, next}

      error ->
        explain_error(error)
    end
  end

  defp explain_error({:error, {:damaged, line, why}}), do: {:error, "line #{line}: #{why}"}
  defp explain_error({:error, {:io, what, _, why}}), do: {:error, "could not #{what}: #{why}"}

  # The separator is guessed from the first line, which starts after any byte order mark.
  defp first_line(path) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]),
         read = :file.pread(file, 0, 64 * 1024),
         :ok <- :file.close(file) do
      case read do
        {:ok, <<0xEF, 0xBB, 0xBF, rest::binary>>} -> {:ok, {3, 1}, take_first_line(rest)}
        {:ok, text} -> {:ok, {0, 1}, take_first_line(text)}
        :eof -> {:error, "it is empty"}
        {:error, reason} -> {:error, reason}
      end
    end
  end

  defp take_first_line(text), do: text |> :binary.split("\n") |> hd()

  defp resolve_separator(nil, line) do
    {:ok,
     Enum.max_by([?,, ?;, ?\t], fn mark -> line |> :binary.matches(<<mark>>) |> length() end)}
  end

  defp resolve_separator(<<mark>>, _line) when mark not in [?", ?\r, ?\n], do: {:ok, mark}

  defp resolve_separator(other, _line),
    do:
      {:error, "#{inspect(other)} is not a valid separator: it must be one byte and not a quote"}

  defp read_heading(scan, start) do
    case read_rows(scan, start, 1) do
      {:ok, [], _} -> {:error, "it is empty"}
      {:ok, [{_, [_]}], _} -> {:error, "its first line has only one column"}
      other -> other
    end
  end

  # If the first line contains only numbers, it is data and not a heading.
  defp column_names(names, {_, fields}, start, second, next) do
    trimmed = Enum.map(names, &String.trim/1)
    sample = with [{_, row}] <- next, do: row, else: (_ -> nil)

    if Enum.all?(trimmed, &(Field.infer_kind(&1) != :string)),
      do: {:ok, Enum.map(0..(length(names) - 1), &"Column#{&1}"), start, fields},
      else: {:ok, trimmed, second, sample}
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

  # Native code handles most files. If it cannot read the next part, the rows are parsed here.
  defp scan_parts(scan, place, last) do
    case native_range?(scan, last) &&
           Native.csv_scan(scan.path, native_layout(scan), {place, last}, @parts) do
      {:ok, parts} ->
        {scan, place, last} = Enum.reduce(parts, {scan, place, last}, &put_part/2)
        if length(parts) < @parts, do: {:ok, scan}, else: scan_parts(scan, place, last)

      slow when slow in [:slow, false] ->
        scan_rows(scan, place, last)

      error ->
        explain_error(error)
    end
  end

  defp put_part({_rows, columns, damage, next, next_last}, {scan, place, last}) do
    part = %{place: place, last: last, counts: message_counts(scan)}

    columns =
      columns
      |> Enum.with_index()
      |> Enum.reduce(scan.columns, fn {found, index}, columns ->
        case columns do
          %{^index => column} -> Map.put(columns, index, merge_column(column, found))
          _ -> columns
        end
      end)

    damage = for {line, why} <- damage, do: damage_entry(scan, line, explain_damage(scan, why))

    {put_damage(%{scan | parts: [part | scan.parts], columns: columns}, Enum.reverse(damage)),
     next, next_last}
  end

  defp merge_column(column, {_kind, 0, _first, _last}), do: column

  defp merge_column(column, {kind, count, first, last}) do
    kind = Field.merge_kinds(column.kind, kind)
    %{column | kind: kind, count: column.count + count, first: column.first || first, last: last}
  end

  defp explain_damage(scan, fields) when is_integer(fields),
    do: "it has #{fields} fields, not #{scan.width}"

  defp explain_damage(_scan, :not_increasing), do: "its time does not increase"
  defp explain_damage(scan, text) when is_binary(text), do: Field.parse_time(text, scan.unit)

  defp scan_rows(scan, place, last) do
    case read_rows(scan, place) do
      {:ok, [], _} ->
        {:ok, scan}

      {:ok, rows, next} ->
        part = %{place: place, last: last, counts: message_counts(scan)}
        {kept, damage, last} = keep_valid_rows(rows, last, scan)
        columns = Enum.reduce(kept, scan.columns, &count_fields/2)
        scan = put_damage(%{scan | parts: [part | scan.parts], columns: columns}, damage)
        scan_parts(scan, next, last)

      {:error, why} ->
        {:error, why}
    end
  end

  defp message_counts(scan),
    do: Map.new(scan.columns, fn {index, column} -> {index, column.count} end)

  # The first entries are kept. The newest entries are at the head of the list.
  defp put_damage(scan, []), do: scan

  defp put_damage(scan, damage),
    do: %{scan | damage: Enum.take(damage ++ scan.damage, -@most_damage)}

  defp damage_entry(scan, line, why), do: {Path.basename(scan.path), line, "line #{line}: #{why}"}

  # Native times have 64 bits.
  defp native_range?(scan, last), do: (last || 0) in @native and scan.start in @native

  defp native_layout(scan) do
    unit = Field.unit_nanoseconds(scan.unit)
    {scan.separator, {scan.width, scan.time}, {unit, scan.start}, {@rows, @bytes}}
  end

  @doc """
  Reads the values of one column, with their times, in the part that begins at `place` after a row with the time `last`.
  Empty fields are omitted.
  """
  @spec read_values(t(), map(), non_neg_integer()) ::
          {:ok, [{Situ.Time.t(), number() | String.t()}]} | {:error, String.t()}
  def read_values(scan, part, index) do
    %{kind: kind} = Map.fetch!(scan.columns, index)
    native? = native_range?(scan, part.last)

    case native? &&
           Native.csv_values(
             scan.path,
             native_layout(scan),
             {part.place, part.last},
             {index, kind}
           ) do
      {:ok, values} -> {:ok, values |> convert_values(kind)}
      slow when slow in [:slow, false] -> values_of_rows(scan, part, index, kind)
      error -> explain_error(error)
    end
  end

  @doc """
  Appends columns of up to `parts` parts, starting with `part`, to streams of a writer. `targets` are `{column, stream,
  sequence}` with the sequence id of the column's first field in `part`. Returns the number of parts and, for each
  column, its number of fields and how many of them are in the interval. Returns `:slow` if native code cannot read
  `part`.
  """
  @spec append_columns(t(), map(), [{non_neg_integer(), Writer.Stream.t(), pos_integer()}], {
          integer(),
          integer()
        }) ::
          {:ok, pos_integer(), [{non_neg_integer(), non_neg_integer()}]}
          | :slow
          | {:error, String.t() | Situ.Error.t()}
  def append_columns(scan, part, [{_, %{writer: writer}, _} | _] = targets, interval) do
    given = for {index, stream, n} <- targets, do: {index, scan.columns[index].kind, stream.id, n}
    start = {part.place, part.last}

    case native_range?(scan, part.last) &&
           Native.csv_append(
             scan.path,
             native_layout(scan),
             start,
             {given, interval, @parts},
             writer.ref
           ) do
      {:ok, parts, counts} ->
        {:ok, parts, counts}

      slow when slow in [:slow, false] ->
        :slow

      {:not_written, {:error, reason}, index} ->
        {_, stream, _} = List.keyfind!(targets, index, 0)
        {:error, NativeErrors.to_error(reason, writer.path, stream.name)}

      error ->
        explain_error(error)
    end
  end

  # Integers that do not fit into 64 bits are returned by native code as strings.
  defp convert_values(values, :string), do: values

  defp convert_values(values, kind) do
    for {time, value} <- values,
        do: {time, if(is_binary(value), do: Field.parse_as(value, kind), else: value)}
  end

  defp values_of_rows(scan, part, index, kind) do
    with {:ok, rows, _next} <- read_rows(scan, part.place) do
      {kept, _damage, _last} = keep_valid_rows(rows, part.last, scan)

      {:ok,
       for(
         {time, row} <- kept,
         text = String.trim(elem(row, index)),
         text != "",
         do: {time, Field.parse_as(text, kind)}
       )}
    end
  end

  defp count_fields({time, row}, columns) do
    Map.new(columns, fn {index, column} ->
      case String.trim(elem(row, index)) do
        "" -> {index, column}
        text -> {index, add_field(column, text, time)}
      end
    end)
  end

  defp add_field(column, text, time) do
    kind =
      if column.kind == :string,
        do: :string,
        else: Field.merge_kinds(column.kind, Field.infer_kind(text))

    %{column | kind: kind, count: column.count + 1, first: column.first || time, last: time}
  end

  @doc """
  Splits rows into valid rows, as `{time, fields as a tuple}`, and damage entries for the other rows, latest first. A
  row is valid if its time increases. The third element is the last valid time.
  """
  @spec keep_valid_rows([row()], Situ.Time.t() | nil, t()) ::
          {[{Situ.Time.t(), tuple()}], [tuple()], Situ.Time.t() | nil}
  def keep_valid_rows(rows, last, scan) do
    {kept, damage, last} =
      Enum.reduce(rows, {[], [], last}, fn {line, row}, {kept, damage, last} ->
        fields = List.to_tuple(row)

        with true <-
               tuple_size(fields) == scan.width ||
                 "it has #{tuple_size(fields)} fields, not #{scan.width}",
             {:ok, time} <- Field.parse_time(elem(fields, scan.time), scan.unit),
             time = time + scan.start,
             true <- last == nil or time > last || "its time does not increase" do
          {[{time, fields} | kept], damage, time}
        else
          why -> {kept, [damage_entry(scan, line, why) | damage], last}
        end
      end)

    {Enum.reverse(kept), damage, last}
  end
end

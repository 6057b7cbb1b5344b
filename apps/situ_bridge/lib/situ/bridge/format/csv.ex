defmodule Situ.Bridge.Format.Csv do
  @moduledoc false
  # Encodes messages as records of comma-separated fields (RFC 4180) with a heading. Lists within an object have no
  # columns, as in \psi; `Situ.Bridge.Format.Csv.Table` writes them.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.{TimeFormat, Value}
  alias Situ.Bridge.Format.Csv.Number
  alias Situ.Bridge.Native
  alias Situ.CsvRow

  @time "_OriginatingTime_"
  @value "_Value_"

  @impl true
  def encode(value, time), do: record(value, time, 0)

  @impl true
  def record(value, time, 0) do
    {names, fields} = value |> named_fields() |> Enum.unzip()
    [CsvRow.encode_row([@time | names]), encode_row(time, fields)]
  end

  def record(value, time, n) when is_integer(n),
    do: encode_row(time, Enum.map(named_fields(value), &elem(&1, 1)))

  # A record has the columns of the heading. Missing members become empty fields, and additional members cannot be
  # written.
  def record(value, time, {_n, names}) do
    columns = named_fields(value)

    if Enum.map(columns, &elem(&1, 0)) == names do
      encode_row(time, Enum.map(columns, &elem(&1, 1)))
    else
      extra = Enum.find(columns, fn {name, field} -> field != nil and name not in names end)
      if extra, do: throw({:not_writable, {:no_column, elem(extra, 0), value}})
      columns = Map.new(columns)
      encode_row(time, Enum.map(names, &columns[&1]))
    end
  end

  @impl true
  def first_position(value), do: {1, value |> named_fields() |> Enum.map(&elem(&1, 0))}

  defp named_fields(value), do: value |> prepare_value() |> value_columns()

  defp encode_row(time, fields),
    do: CsvRow.encode_row([TimeFormat.to_iso8601(time) | Enum.map(fields, &format_field/1)])

  @impl true
  def columns(%{kind: kind, times: times, values: values}, position) do
    heading = if position == 0, do: CsvRow.encode_row([@time, @value]), else: []
    [heading, Native.csv_lines(kind, times, values)]
  end

  @impl true
  def finish(_n), do: ""

  # A list that contains only floats becomes an array of doubles, with a column for each element.
  defp prepare_value(list) when is_list(list) and list != [] do
    if Enum.all?(list, &double?/1), do: {:doubles, list}, else: Value.to_plain(list)
  end

  defp prepare_value(value) when value in [:nan, :infinity, :neg_infinity], do: value
  defp prepare_value(value), do: Value.to_plain(value)

  defp double?(x), do: is_float(x) or x in [:nan, :infinity, :neg_infinity]

  defp value_columns({:doubles, list}),
    do: for({x, i} <- Enum.with_index(list), do: {"_Column#{i}_", x})

  defp value_columns({pairs}), do: Enum.flat_map(pairs, &flatten_member/1)
  defp value_columns(list) when is_list(list), do: []
  defp value_columns(value), do: [{@value, value}]

  # Nested objects are flattened into columns with the names of their members; nested lists have no columns.
  defp flatten_member({_key, {pairs}}), do: Enum.flat_map(pairs, &flatten_member/1)
  defp flatten_member({_key, list}) when is_list(list), do: []
  defp flatten_member(pair), do: [pair]

  @doc """
  Returns the names of the lists in a value for which a record has no columns.

      iex> Situ.Bridge.Format.Csv.list_omitted(%{name: "a", place: %{position: {1.0, 2.0}}})
      ["position"]
  """
  @spec list_omitted(term()) :: [String.t()]
  def list_omitted(value) do
    case prepare_value(value) do
      {pairs} when is_list(pairs) -> Enum.flat_map(pairs, &omitted_names/1)
      _ -> []
    end
  end

  defp omitted_names({_key, {pairs}}), do: Enum.flat_map(pairs, &omitted_names/1)
  defp omitted_names({key, [_ | _]}), do: [key]
  defp omitted_names(_pair), do: []

  @doc "Encodes one field, without quotation marks."
  @spec format_field(nil | boolean() | number() | String.t() | atom()) :: String.t()
  def format_field(nil), do: ""
  def format_field(true), do: "True"
  def format_field(false), do: "False"
  def format_field(text) when is_binary(text), do: text
  def format_field(number), do: Number.encode_number(number)

  @impl true
  def decode(bytes, opts) do
    case split(bytes, start(), true, opts) do
      {:ok, [message], _} -> {:ok, message}
      {:ok, [], _} -> {:error, "it has no record"}
      {:ok, _more, _} -> {:error, "it has more than one record"}
      error -> error
    end
  end

  @impl true
  def start, do: nil

  @impl true
  def split(bytes, nil, last?, opts) do
    case CsvRow.parse_row(bytes, last?) do
      {:ok, [@time | names], rest} -> split(rest, names, last?, opts)
      {:ok, _other, _rest} -> {:error, "its first column is not #{@time}"}
      :more when last? and bytes != "" -> {:error, "it has no heading"}
      :more -> {:ok, [], {bytes, nil}}
      error -> error
    end
  end

  def split(bytes, names, last?, opts), do: parse_records(bytes, names, last?, opts, [])

  defp parse_records(bytes, names, last?, opts, messages) do
    case CsvRow.parse_row(bytes, last?) do
      {:ok, [""], rest} ->
        parse_records(rest, names, last?, opts, messages)

      {:ok, [stamp | fields], rest} ->
        case parse_record(stamp, fields, names, opts) do
          {:ok, message} -> parse_records(rest, names, last?, opts, [message | messages])
          {:error, why} -> stop_at_error(why, bytes, names, messages)
        end

      :more ->
        {:ok, Enum.reverse(messages), {if(last?, do: "", else: bytes), names}}

      {:error, why} ->
        stop_at_error(why, bytes, names, messages)
    end
  end

  # Messages before an error are emitted first; the error is returned by the next call.
  defp stop_at_error(why, _bytes, _names, []), do: {:error, why}

  defp stop_at_error(_why, bytes, names, messages),
    do: {:ok, Enum.reverse(messages), {bytes, names}}

  defp parse_record(stamp, fields, names, opts) do
    with {:ok, time} <- Situ.Time.parse(stamp), true <- length(fields) == length(names) do
      {:ok, {time, build_value(names, fields, opts)}}
    else
      {:error, error} ->
        {:error, error.what}

      false ->
        {:error,
         "a record has #{length(fields) + 1} fields, but the heading has #{length(names) + 1}"}
    end
  end

  defp build_value([@value], [field], _opts), do: Number.parse_field(field)

  defp build_value(["_Column0_" | _], fields, _opts),
    do: Enum.map(fields, &to_double(Number.parse_field(&1)))

  defp build_value(names, fields, opts) do
    pairs =
      names
      |> Enum.zip(fields)
      |> Enum.map(fn {name, field} -> {name, Number.parse_field(field)} end)

    Value.shape_objects({pairs}, opts)
  end

  defp to_double(n) when is_integer(n), do: n / 1
  defp to_double(other), do: other
end

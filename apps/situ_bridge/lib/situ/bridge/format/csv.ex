defmodule Situ.Bridge.Format.Csv do
  @moduledoc false
  # Encodes messages as records of comma-separated fields (RFC 4180) with a heading.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.{Stamp, Value}
  alias Situ.Bridge.Format.Csv.{Number, Row}
  alias Situ.Bridge.Native

  @time "_OriginatingTime_"
  @value "_Value_"

  @impl true
  def encode(value, time), do: record(value, time, 0)

  @impl true
  def record(value, time, 0) do
    {names, fields} = value |> laid_out() |> Enum.unzip()
    [Row.write([@time | names]), row(time, fields)]
  end

  def record(value, time, n) when is_integer(n),
    do: row(time, Enum.map(laid_out(value), &elem(&1, 1)))

  # A record has the columns of the heading: missing members become empty fields, additional members cannot be
  # written.
  def record(value, time, {_n, names}) do
    columns = laid_out(value)

    if Enum.map(columns, &elem(&1, 0)) == names do
      row(time, Enum.map(columns, &elem(&1, 1)))
    else
      beyond = Enum.find(columns, fn {name, held} -> held != nil and name not in names end)
      if beyond, do: throw({:not_writable, {:no_column, elem(beyond, 0), value}})
      columns = Map.new(columns)
      row(time, Enum.map(names, &columns[&1]))
    end
  end

  @impl true
  def headed(value), do: {1, value |> laid_out() |> Enum.map(&elem(&1, 0))}

  defp laid_out(value), do: value |> shape() |> columns()
  defp row(time, fields), do: Row.write([Stamp.iso8601(time) | Enum.map(fields, &field/1)])

  @impl true
  def columns(%{kind: kind, times: times, values: values}, place) do
    heading = if place == 0, do: Row.write([@time, @value]), else: []
    [heading, Native.csv_lines(kind, times, values)]
  end

  @impl true
  def finish(_n), do: ""

  # A list that contains only floats is an array of doubles, which has a column per element.
  defp shape(list) when is_list(list) and list != [] do
    if Enum.all?(list, &double?/1), do: {:doubles, list}, else: Value.plain(list)
  end

  defp shape(value) when value in [:nan, :infinity, :neg_infinity], do: value
  defp shape(value), do: Value.plain(value)

  defp double?(x), do: is_float(x) or x in [:nan, :infinity, :neg_infinity]

  defp columns({:doubles, list}),
    do: for({x, i} <- Enum.with_index(list), do: {"_Column#{i}_", x})

  defp columns({pairs}), do: Enum.flat_map(pairs, &member/1)
  defp columns(list) when is_list(list), do: []
  defp columns(value), do: [{@value, value}]

  # Nested objects are flattened into columns with the names of their members; nested lists have no columns.
  defp member({_key, {pairs}}), do: Enum.flat_map(pairs, &member/1)
  defp member({_key, list}) when is_list(list), do: []
  defp member(pair), do: [pair]

  defp field(nil), do: ""
  defp field(true), do: "True"
  defp field(false), do: "False"
  defp field(text) when is_binary(text), do: text
  defp field(number), do: Number.write(number)

  @impl true
  def decode(bytes, opts) do
    case split(bytes, start(), true, opts) do
      {:ok, [timed], _} -> {:ok, timed}
      {:ok, [], _} -> {:error, "it has no record"}
      {:ok, _more, _} -> {:error, "it has more than one record"}
      error -> error
    end
  end

  @impl true
  def start, do: nil

  @impl true
  def split(bytes, nil, last?, opts) do
    case Row.read(bytes, last?) do
      {:ok, [@time | names], rest} -> split(rest, names, last?, opts)
      {:ok, _other, _rest} -> {:error, "its first column is not #{@time}"}
      :more when last? and bytes != "" -> {:error, "it has no heading"}
      :more -> {:ok, [], {bytes, nil}}
      error -> error
    end
  end

  def split(bytes, names, last?, opts), do: records(bytes, names, last?, opts, [])

  defp records(bytes, names, last?, opts, found) do
    case Row.read(bytes, last?) do
      {:ok, [""], rest} ->
        records(rest, names, last?, opts, found)

      {:ok, [stamp | fields], rest} ->
        case timed(stamp, fields, names, opts) do
          {:ok, timed} -> records(rest, names, last?, opts, [timed | found])
          {:error, why} -> stop(why, bytes, names, found)
        end

      :more ->
        {:ok, Enum.reverse(found), {if(last?, do: "", else: bytes), names}}

      {:error, why} ->
        stop(why, bytes, names, found)
    end
  end

  # Messages before an error are emitted first; the error is returned by the next call.
  defp stop(why, _bytes, _names, []), do: {:error, why}
  defp stop(_why, bytes, names, found), do: {:ok, Enum.reverse(found), {bytes, names}}

  defp timed(stamp, fields, names, opts) do
    with {:ok, time} <- Situ.Time.parse(stamp), true <- length(fields) == length(names) do
      {:ok, {time, value(names, fields, opts)}}
    else
      {:error, error} ->
        {:error, error.what}

      false ->
        {:error,
         "a record has #{length(fields) + 1} fields, but the heading has #{length(names) + 1}"}
    end
  end

  defp value([@value], [field], _opts), do: Number.read(field)

  defp value(["_Column0_" | _], fields, _opts), do: Enum.map(fields, &double(Number.read(&1)))

  defp value(names, fields, opts) do
    pairs =
      names |> Enum.zip(fields) |> Enum.map(fn {name, field} -> {name, Number.read(field)} end)

    Value.shaped({pairs}, opts)
  end

  defp double(n) when is_integer(n), do: n / 1
  defp double(other), do: other
end

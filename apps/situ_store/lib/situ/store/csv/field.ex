defmodule Situ.Store.Csv.Field do
  @moduledoc false
  # Converts fields of a CSV file to values and times. Pure.

  @units %{s: 1_000_000_000, ms: 1_000_000, us: 1_000, ns: 1}

  @times -0x8000000000000000..0x7FFFFFFFFFFFFFFF
  # Longer integers would not fit into a float if the column became a float column.
  @most_digits 300

  @type kind :: :integer | :float | :string

  @doc "Returns the field as a number if it looks like one, or else as a string."
  @spec parse_value(String.t()) :: number() | String.t()
  def parse_value(text) do
    case Integer.parse(text) do
      {n, ""} -> n
      _ -> parse_float(text)
    end
  end

  defp parse_float(text) do
    case Float.parse(text) do
      {x, ""} -> x
      _ -> text
    end
  end

  @doc "Returns the kind of value that a field looks like."
  @spec infer_kind(String.t()) :: kind()
  def infer_kind(text) do
    case parse_value(text) do
      n when is_integer(n) and byte_size(text) <= @most_digits -> :integer
      x when is_float(x) -> :float
      _ -> :string
    end
  end

  @doc """
  Merges the kind of a column so far with the kind of its next field: integers and floats become floats, and strings
  with anything else become strings.
  """
  @spec merge_kinds(kind() | nil, kind()) :: kind()
  def merge_kinds(nil, kind), do: kind
  def merge_kinds(kind, kind), do: kind
  def merge_kinds(a, b) when a == :string or b == :string, do: :string
  def merge_kinds(_, _), do: :float

  @doc "Returns the field as a value of its column's kind. Fields of a string column are unchanged."
  @spec parse_as(String.t(), kind()) :: number() | String.t()
  def parse_as(text, :string), do: text
  def parse_as(text, :integer), do: parse_value(text)
  def parse_as(text, :float), do: parse_value(text) / 1

  @doc "Returns the nanoseconds of a unit, or 0 for ISO 8601."
  @spec unit_nanoseconds(atom()) :: non_neg_integer()
  def unit_nanoseconds(:iso8601), do: 0
  def unit_nanoseconds(unit), do: @units[unit]

  @spec parse_time(String.t(), atom()) :: {:ok, Situ.Time.t()} | String.t()
  def parse_time(text, :iso8601) do
    case Situ.Time.parse(String.trim(text)) do
      {:ok, time} -> {:ok, time}
      {:error, error} -> error.what
    end
  end

  def parse_time(text, unit) do
    # Times have 64 bits, so larger numbers are rejected before the multiplication.
    time =
      case parse_value(String.trim(text)) do
        n when is_integer(n) -> n * @units[unit]
        x when is_float(x) and abs(x) < 1.0e19 -> round_time(x * @units[unit])
        _ -> nil
      end

    if time in @times, do: {:ok, time}, else: "#{inspect(text)} is not a valid time"
  end

  defp round_time(x), do: if(abs(x) < 9.2e18, do: round(x))

  @doc "Returns the given unit of a time column, or detects it from the column's name and first field."
  @spec resolve_unit(String.t(), String.t() | nil, atom()) :: {:ok, atom()} | {:error, String.t()}
  def resolve_unit(_name, nil, :auto), do: {:ok, :s}

  def resolve_unit(name, sample, :auto) do
    match = Regex.run(~r/(?:_|\(|\[|\s)(ns|us|µs|ms|s)\b/u, name)

    cond do
      infer_kind(String.trim(sample)) == :string -> {:ok, :iso8601}
      match -> {:ok, suffix_unit(List.last(match))}
      true -> {:ok, :s}
    end
  end

  def resolve_unit(_name, _sample, unit) when unit in [:s, :ms, :us, :ns, :iso8601],
    do: {:ok, unit}

  def resolve_unit(_name, _sample, unit), do: {:error, "#{inspect(unit)} is not a unit of time"}

  defp suffix_unit("µs"), do: :us
  defp suffix_unit("ns"), do: :ns
  defp suffix_unit("us"), do: :us
  defp suffix_unit("ms"), do: :ms
  defp suffix_unit("s"), do: :s
end

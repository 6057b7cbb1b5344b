defmodule Situ.Store.Csv.Field do
  @moduledoc false
  # Converts fields of a CSV file to values and times. Pure.

  @units %{s: 1_000_000_000, ms: 1_000_000, us: 1_000, ns: 1}

  @times -0x8000000000000000..0x7FFFFFFFFFFFFFFF
  # Longer integers would not fit into a float if the column became a float column.
  @most_digits 300

  @type kind :: :integer | :float | :string

  @doc "Returns the field as a number if it looks like one, or else as a string."
  @spec value(String.t()) :: number() | String.t()
  def value(text) do
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

  @doc "Returns the kind of value that a field looks like."
  @spec kind(String.t()) :: kind()
  def kind(text) do
    case value(text) do
      n when is_integer(n) and byte_size(text) <= @most_digits -> :integer
      x when is_float(x) -> :float
      _ -> :string
    end
  end

  @doc """
  Merges the kind of a column so far with the kind of its next field: integers and floats become floats, and strings
  with anything else become strings.
  """
  @spec unify(kind() | nil, kind()) :: kind()
  def unify(nil, kind), do: kind
  def unify(kind, kind), do: kind
  def unify(a, b) when a == :string or b == :string, do: :string
  def unify(_, _), do: :float

  @doc "Returns the field as a value of its column's kind. Fields of a string column are unchanged."
  @spec as(String.t(), kind()) :: number() | String.t()
  def as(text, :string), do: text
  def as(text, :integer), do: value(text)
  def as(text, :float), do: value(text) / 1

  @doc "Returns the nanoseconds of a unit, or 0 for ISO 8601."
  @spec nanoseconds(atom()) :: non_neg_integer()
  def nanoseconds(:iso8601), do: 0
  def nanoseconds(unit), do: @units[unit]

  @spec time(String.t(), atom()) :: {:ok, Situ.Time.t()} | String.t()
  def time(text, :iso8601) do
    case Situ.Time.parse(String.trim(text)) do
      {:ok, time} -> {:ok, time}
      {:error, error} -> error.what
    end
  end

  def time(text, unit) do
    # Times have 64 bits, so larger numbers are rejected before the multiplication.
    time =
      case value(String.trim(text)) do
        n when is_integer(n) -> n * @units[unit]
        x when is_float(x) and abs(x) < 1.0e19 -> round_time(x * @units[unit])
        _ -> nil
      end

    if time in @times, do: {:ok, time}, else: "#{inspect(text)} is not a valid time"
  end

  defp round_time(x), do: if(abs(x) < 9.2e18, do: round(x))

  @doc "Returns the given unit of a time column, or detects it from the column's name and first field."
  @spec unit(String.t(), String.t() | nil, atom()) :: {:ok, atom()} | {:error, String.t()}
  def unit(_name, nil, :auto), do: {:ok, :s}

  def unit(name, sample, :auto) do
    match = Regex.run(~r/(?:_|\(|\[|\s)(ns|us|µs|ms|s)\b/u, name)

    cond do
      kind(String.trim(sample)) == :string -> {:ok, :iso8601}
      match -> {:ok, suffix(List.last(match))}
      true -> {:ok, :s}
    end
  end

  def unit(_name, _sample, unit) when unit in [:s, :ms, :us, :ns, :iso8601], do: {:ok, unit}
  def unit(_name, _sample, unit), do: {:error, "#{inspect(unit)} is not a unit of time"}

  defp suffix("µs"), do: :us
  defp suffix("ns"), do: :ns
  defp suffix("us"), do: :us
  defp suffix("ms"), do: :ms
  defp suffix("s"), do: :s
end

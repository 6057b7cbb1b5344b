defmodule Situ.CLI.Option do
  @moduledoc false
  # One option of a verb. It determines parsing, the line in `--help` and the manual, and
  # completion.
  #
  # `type` is `:flag`, `:string`, `:path`, `:integer`, `:float`, `:time` (ISO 8601, or nanoseconds
  # since 1970), `:span` (`10s`, `250ms`), or a list of allowed words. `value` is the name of the
  # value in help; `many?` options may be given several times; `negated?` flags are on unless
  # `--no-NAME` is given.
  @enforce_keys [:name, :type, :doc]
  defstruct [:name, :type, :doc, :short, :value, :default, many?: false, negated?: false]

  @type type :: :flag | :string | :path | :integer | :float | :time | :span | [String.t()]
  @type t :: %__MODULE__{
          name: atom(),
          type: type(),
          doc: String.t(),
          short: atom() | nil,
          value: String.t() | nil,
          default: term(),
          many?: boolean(),
          negated?: boolean()
        }

  @doc """
  Builds an option; `more` sets `short:`, `value:`, `default:`, `many?:`, `negated?:`.

      iex> alias Situ.CLI.Option
      iex> option = Option.new(:length, :span, "so long")
      iex> {Option.label(option), Option.parse_value(option, "1.5m")}
      {"--length SPAN", {:ok, 90_000_000_000}}
      iex> Option.parse_value(option, "soon")
      {:error, "--length takes a span of time like 10s, 250ms, 1.5m or 1h, not \\"soon\\""}
  """
  @spec new(atom(), type(), String.t(), keyword()) :: t()
  def new(name, type, doc, more \\ []),
    do: struct!(%__MODULE__{name: name, type: type, doc: doc}, more)

  @doc "Returns the option as it is typed, without its value: `--skip-damage`."
  @spec switch_name(t()) :: String.t()
  def switch_name(%__MODULE__{name: name}),
    do: "--" <> (name |> Atom.to_string() |> String.replace("_", "-"))

  @doc "Returns the option as help shows it: `-s, --stream NAME`."
  @spec label(t()) :: String.t()
  def label(%__MODULE__{} = option) do
    short = if option.short, do: "-#{option.short}, ", else: ""

    switch =
      if option.negated?,
        do: String.replace_prefix(switch_name(option), "--", "--no-"),
        else: switch_name(option)

    value = value_name(option)
    short <> switch <> if(value, do: " " <> value, else: "")
  end

  @doc "Returns the name of the option's value, `nil` for a flag."
  @spec value_name(t()) :: String.t() | nil
  def value_name(%__MODULE__{type: :flag}), do: nil
  def value_name(%__MODULE__{value: value}) when value != nil, do: value
  def value_name(%__MODULE__{type: words}) when is_list(words), do: Enum.join(words, "|")
  def value_name(%__MODULE__{type: :integer}), do: "N"
  def value_name(%__MODULE__{type: :float}), do: "X"
  def value_name(%__MODULE__{type: :string}), do: "TEXT"
  def value_name(%__MODULE__{type: type}), do: type |> Atom.to_string() |> String.upcase()

  @doc "Parses `text` as a value of this option; the error is a sentence for the user."
  @spec parse_value(t(), String.t()) :: {:ok, term()} | {:error, String.t()}
  def parse_value(%__MODULE__{type: type}, text) when type in [:string, :path], do: {:ok, text}

  def parse_value(%__MODULE__{type: :integer} = option, text) do
    case Integer.parse(text) do
      {n, ""} -> {:ok, n}
      _ -> type_error(option, "a whole number", text)
    end
  end

  def parse_value(%__MODULE__{type: :float} = option, text) do
    case Float.parse(text) do
      {x, ""} -> {:ok, x}
      _ -> type_error(option, "a number", text)
    end
  end

  def parse_value(%__MODULE__{type: :time} = option, text) do
    with :error <- parse_integer(text),
         {:error, _} <- text |> complete_time() |> Situ.Time.parse() do
      type_error(
        option,
        "a time like 2026-01-31T12:34:56.789Z (or 2026-01-31T12:34, or 2026-01-31 for its midnight; all of them " <>
          "UTC unless a zone like +02:00 is given), or nanoseconds since 1970",
        text
      )
    end
  end

  def parse_value(%__MODULE__{type: :span} = option, text) do
    with :error <- Situ.Time.parse_duration(text),
         do: type_error(option, "a span of time like 10s, 250ms, 1.5m or 1h", text)
  end

  def parse_value(%__MODULE__{type: words} = option, text) when is_list(words) do
    if text in words, do: {:ok, text}, else: type_error(option, Enum.join(words, ", "), text)
  end

  @doc """
  Completes a time with the parts that people leave out: `2026-01-31` means its midnight, and `2026-01-31T12:34` has
  no seconds.

      iex> Situ.CLI.Option.complete_time("2026-01-31")
      "2026-01-31T00:00:00"
      iex> Situ.CLI.Option.complete_time("2026-01-31 12:34+02:00")
      "2026-01-31T12:34:00+02:00"
  """
  @spec complete_time(String.t()) :: String.t()
  def complete_time(text) do
    case Regex.run(~r/\A(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d))?(Z|[+-]\d\d:?\d\d)?\z/, text) do
      [_, date] -> date <> "T00:00:00"
      [_, date, time] -> date <> "T" <> time <> ":00"
      [_, date, "", zone] -> date <> "T00:00:00" <> zone
      [_, date, time, zone] -> date <> "T" <> time <> ":00" <> zone
      nil -> text
    end
  end

  defp parse_integer(text) do
    case Integer.parse(text) do
      {ns, ""} -> {:ok, ns}
      _ -> :error
    end
  end

  defp type_error(option, wanted, text),
    do: {:error, "#{switch_name(option)} takes #{wanted}, not #{inspect(text)}"}
end

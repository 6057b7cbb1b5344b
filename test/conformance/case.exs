defmodule Situ.Conformance.Case do
  # Shared functions of the areas: times, values with their tolerance, and verdicts.

  alias Situ.Conformance.{Facts, Text}

  # Facts is loaded later, because it uses this module.
  @compile {:no_warn_undefined, Facts}

  @tick 100
  @ms 1_000_000

  # Special numbers are strings in the files and atoms in Situ.
  def value("NaN"), do: :nan
  def value("Infinity"), do: :infinity
  def value("-Infinity"), do: :neg_infinity
  def value(list) when is_list(list), do: Enum.map(list, &value/1)
  def value(map) when is_map(map), do: Map.new(map, fn {k, v} -> {k, value(v)} end)
  def value(other), do: other

  def time(message),
    do: Text.duration(message, "t") || Text.unknown!("a message without a time", message)

  defdelegate duration(params, key), to: Text

  def ticks(n), do: n * @tick
  def ms(n), do: round(n * @ms)

  # `[{time, value}]` for a list of messages or an expectation.
  def timed(messages), do: Enum.map(messages, &{time(&1), value(&1["v"])})

  def messages(messages),
    do: for({t, v} <- timed(messages), do: %Situ.Message{originating_time: t, data: v})

  # Situ returns tuples for the files' arrays.
  def plain(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> plain()
  def plain(list) when is_list(list), do: Enum.map(list, &plain/1)
  def plain(%_{} = struct), do: struct
  def plain(map) when is_map(map), do: Map.new(map, fn {k, v} -> {k, plain(v)} end)
  def plain(other), do: other

  def same?(expected, got, tolerance \\ 1.0e-12)
  def same?(a, b, _) when is_integer(a) and is_integer(b), do: a == b

  def same?(a, b, tolerance) when is_number(a) and is_number(b),
    do: abs(a - b) <= tolerance * max(1.0, max(abs(a), abs(b)))

  def same?(a, b, tolerance) when is_list(a) and is_list(b),
    do:
      length(a) == length(b) and
        Enum.all?(Enum.zip(a, b), fn {x, y} -> same?(x, y, tolerance) end)

  def same?({t, a}, {u, b}, tolerance), do: t == u and same?(a, b, tolerance)

  def same?(a, b, tolerance) when is_map(a) and is_map(b),
    do: Map.keys(a) == Map.keys(b) and Enum.all?(a, fn {k, v} -> same?(v, b[k], tolerance) end)

  def same?(a, b, _), do: a == b

  def verdict(expected, got, tolerance \\ 1.0e-12) do
    if same?(expected, got, tolerance), do: :pass, else: {:fail, expected, got}
  end

  # Compares every part of an expectation with the result. A part without a check is a failure.
  def all(case, got, tolerance \\ 1.0e-12)

  def all(%{"expect" => %{} = expect}, got, tolerance) do
    case Map.keys(expect) -- Map.keys(got) do
      [] ->
        got = Map.take(got, Map.keys(expect))
        unread = for {key, {:unread, _}} <- got, do: key
        if unread == [], do: parts(expect, plain(got), tolerance), else: unread(expect, unread)

      unread ->
        unread(expect, unread)
    end
  end

  def all(%{"expect" => expect}, got, _tolerance), do: {:fail, expect, got}

  defp parts(expect, got, tolerance),
    do: verdict(value(expect), Map.new(got, &settle(&1, expect)), tolerance)

  defp unread(expect, keys) do
    parts = Enum.map_join(keys, ", ", &inspect({&1, expect[&1]}))
    {:fail, expect, "no rule reads these parts of the expectation: #{parts}"}
  end

  # A comparison as text (">= 1") stands for every number that satisfies it.
  defp settle({key, number}, expect),
    do: {key, if(Text.compare(expect[key], number) == true, do: expect[key], else: number)}

  # A property as text: returns the text itself if one of the readings matches it and holds.
  # `readings`: `{regex, holds?}`, or a function of the regex captures. The regex must match the
  # entire text.
  def told(text, readings) when is_binary(text) do
    Enum.find_value(readings, {:unread, text}, fn {regex, holds?} ->
      case Regex.run(regex, text) do
        [^text | captured] -> if holds(holds?, captured), do: text, else: {:not_so, text}
        _ -> nil
      end
    end)
  end

  def told(other, _readings), do: {:unread, other}

  # The same for texts that vary: the text must contain `regex`, and consist of words only.
  def meant(text, regex, holds?) when is_binary(text) do
    cond do
      not (text =~ regex) or text =~ "_" -> {:unread, text}
      holds? -> text
      true -> {:not_so, text}
    end
  end

  def meant(other, _regex, _holds?), do: {:unread, other}

  defp holds(fun, captured) when is_function(fun, 1), do: fun.(captured)
  defp holds(holds?, _captured), do: holds?

  # Compares the outputs `[{time, value}]` of an operator with the case.
  def outputs(case, result, tolerance \\ 1.0e-12)

  def outputs(%{"expect_error" => code}, {:error, error}, _tolerance) do
    if error_fits?(code, error), do: :pass, else: {:fail, {:error, code}, error}
  end

  def outputs(%{"expect_error" => code}, {:ok, got}, _tolerance), do: {:fail, {:error, code}, got}
  def outputs(case, {:error, error}, _tolerance), do: {:fail, case["expect"], error}

  def outputs(%{"expect" => expect}, {:ok, got}, tolerance) when is_list(expect),
    do: verdict(timed(expect), Enum.map(got, fn {t, v} -> {t, plain(v)} end), tolerance)

  # The expectation states facts about the outputs.
  def outputs(%{"expect" => %{} = expect} = case, {:ok, got}, tolerance),
    do: all(case, Facts.of(expect, got), tolerance)

  def outputs(case, {:ok, got}, _tolerance), do: {:fail, case["expect"], got}

  # Maps error names in the files to Situ's codes.
  @codes %{
    "argument_error" => [ArgumentError],
    "not_supported" => [:not_supported],
    "invalid_operation" => [
      :empty_list,
      :wrong_length,
      :already_connected,
      :pipeline_running,
      :duplicate_name,
      :ambiguous_stream,
      :window_negative,
      :window_not_finite,
      :window_before_obsolete,
      :obsolete_time_before_previous,
      :time_not_increasing
    ],
    "empty_sequence" => [:empty_list],
    "division_by_zero" => [ArithmeticError],
    "validator_error" => [ArgumentError],
    "originating_times_not_increasing" => [:time_not_increasing],
    "originating_time_not_strictly_increasing" => [:time_not_increasing]
  }

  # Names of errors that vary. They consist of these words, and the first match applies.
  @vocabulary ~w(obsolete time window interval before previous precedes prior into back backwards went goes
                 moves earlier decreases than begins starts negative is not finite infinite unbounded dynamic)

  @words [
    {~r/^obsolete.*(back|before|earlier|decreas)/, :obsolete_time_before_previous},
    {~r/(before|precedes|prior|into).*obsolete/, :window_before_obsolete},
    {~r/negative/, :window_negative},
    {~r/not_finite|infinite|unbounded/, :window_not_finite}
  ]

  # An aggregate error contains all errors of the pipeline, one of which must have the expected
  # name.
  def error_fits?(_name, %Text.UnknownForm{}), do: false

  def error_fits?("aggregate_pipeline_error(" <> name, error),
    do: error |> errors() |> Enum.any?(&error_fits?(String.replace_suffix(name, ")", ""), &1))

  def error_fits?(name, error) do
    code = code(error)
    code in Map.get(@codes, name, [by_words(name)]) or to_string(code) == name
  end

  defp by_words(name) do
    if String.split(name, "_") -- @vocabulary == [],
      do: Enum.find_value(@words, fn {words, code} -> name =~ words && code end)
  end

  defp errors(%Situ.Error{meta: %{errors: [_ | _] = errors}}), do: errors
  defp errors(error), do: [error]

  # The innermost cause, since a pipeline wraps the errors of its components.
  defp code(%Situ.Error{meta: %{reason: %_{} = inner}}), do: code(inner)
  defp code(%Situ.Error{meta: %{cause: %_{} = inner}}), do: code(inner)
  defp code(%Situ.Error{meta: %{exception: %_{} = inner}}), do: code(inner)
  defp code(%Situ.Error{code: code}), do: code
  defp code(%module{}), do: module
  defp code(other), do: other

  def attempt(fun) do
    {:ok, fun.()}
  rescue
    error -> {:error, error}
  end
end

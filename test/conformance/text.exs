defmodule Situ.Conformance.Text do
  # Reads quantities in the texts of cases: durations ("50 ms"), intervals ("[-10 ms, 20 ms]"),
  # ranges ("0..9") and comparisons (">= 3", "at most 5 ms", "between 99 and 102"). A text is read
  # from its first to its last letter, so nothing in it is ignored.

  defmodule UnknownForm do
    # A part of a case that no rule reads. It never fits an error that a case expects.
    defexception [:message]
  end

  @units %{
    "ns" => 1,
    "tick" => 100,
    "us" => 1_000,
    "ms" => 1_000_000,
    "millisecond" => 1_000_000,
    "s" => 1_000_000_000,
    "second" => 1_000_000_000,
    "min" => 60_000_000_000,
    "minute" => 60_000_000_000,
    "h" => 3_600_000_000_000,
    "hour" => 3_600_000_000_000
  }

  @number "[-+]?\\d+(?:\\.\\d+)?"
  @unit "ns|ticks?|us|ms|milliseconds?|s|seconds?|min|minutes?|h|hours?"
  @words "(?: (?:messages?|values?|outputs?|times?|items?|calls?))?"
  @comparisons "<=?|>=?|==?|at least|at most|no more than|not more than|up to|more than|" <>
                 "less than|fewer than|greater than|exactly"
  @unbounded ~w(-inf -infinity inf +inf infinity +infinity min max unbounded infinite) ++
               ["∞", "-∞"]

  # Raises an error that names the part of a case that no rule reads.
  def unknown!(what, text),
    do: raise(UnknownForm, "#{what} is not understood: #{inspect(text)}")

  # Returns ns per unit ("ms", "ticks", "seconds" ...), or nil.
  def unit(name), do: @units[name] || @units[String.trim_trailing(name, "s")]

  # Returns the value of a key with its unit ("delay_ms", "from_ticks") in ns, or nil.
  def duration(params, key) do
    Enum.find_value(~w(ns ticks us ms s min minutes h), fn name ->
      n = params["#{key}_#{name}"]
      is_number(n) && round(n * unit(name))
    end)
  end

  # Reads "50 ms" or "-2s" in ns. A number alone has the unit `default`.
  def duration!(text, default \\ nil) do
    case Regex.run(~r/^\s*(#{@number})\s*(#{@unit})?\s*$/i, text) do
      [_, n, name] -> round(number(n) * unit(String.downcase(name)))
      [_, n] when default != nil -> round(number(n) * unit(default))
      _ -> unknown!("a duration", text)
    end
  end

  # Reads an interval of time around a message as {left, left_in?, right, right_in?}, each end in
  # ns or :unbounded: "[-10 ms, 20 ms)", "-10 to 20 ms", "-10ms..+20ms", "past 2 ms".
  def interval!(text) do
    text = text |> String.trim() |> String.replace(["−", "–"], "-")

    case Regex.run(
           ~r/^([\[(])?\s*(.+?)\s*(?:,|\.\.\.?|\bto\b|\band\b)\s*(.+?)\s*([\])])?$/i,
           text
         ) do
      [_, open, left, right | close] -> bounds(open, left, right, List.first(close) || "]")
      nil -> one_sided(text)
    end
  end

  defp bounds(open, left, right, close) do
    left = Regex.replace(~r/^(?:from|between)\s+/i, left, "")
    default = with [_, name] <- Regex.run(~r/(#{@unit})$/i, right), do: String.downcase(name)
    {left, right} = {bound(left, default), bound(right, default)}
    {left, open != "(" and left != :unbounded, right, close == "]" and right != :unbounded}
  end

  defp bound(text, default),
    do: if(String.downcase(text) in @unbounded, do: :unbounded, else: duration!(text, default))

  defp one_sided(text) do
    case Regex.run(~r/^(past|future)\s*\(?\s*([^()]*)\)?$/i, text) do
      [_, side, ""] -> one_sided(String.downcase(side), :unbounded)
      [_, side, span] -> one_sided(String.downcase(side), duration!(span))
      nil -> unknown!("an interval", text)
    end
  end

  defp one_sided("past", :unbounded), do: {:unbounded, false, 0, true}
  defp one_sided("past", span), do: {-span, true, 0, true}
  defp one_sided("future", :unbounded), do: {0, true, :unbounded, false}
  defp one_sided("future", span), do: {0, true, span, true}

  @numbers ~w(zero one two three four five six seven eight nine ten eleven twelve)

  # Returns the first number in a text, also as a word ("seven"), or nil.
  def word_number(text) do
    Enum.find_value(Regex.scan(~r/[a-z]+|\d+/i, text), fn [word] ->
      case Integer.parse(word) do
        {n, ""} -> n
        _ -> Enum.find_index(@numbers, &(&1 == String.downcase(word)))
      end
    end)
  end

  # Returns the numbers of "0..9" (both included), a list as it is, and nil for other texts.
  def range(list) when is_list(list), do: list

  def range(text) when is_binary(text) do
    case Regex.run(~r/^\s*(-?\d+)\s*(?:\.\.\.?|to)\s*(-?\d+)\s*$/, text) do
      [_, from, to] -> Enum.to_list(String.to_integer(from)..String.to_integer(to)//1)
      nil -> nil
    end
  end

  def range(_other), do: nil

  # Returns whether a number satisfies a comparison as text, or nil if the text is none. A unit in
  # the text is that of the number, unless `ns: true`: then the number is in ns.
  def compare(text, number, opts \\ [])

  def compare(text, number, opts) when is_binary(text) and is_number(number) do
    text = text |> String.trim() |> String.downcase() |> String.replace("≥", ">=")
    scale = fn n, name -> number(n) * if(opts[:ns] && name != "", do: unit(name), else: 1) end

    case {run_comparison(text), run_span(text)} do
      {[_, how, n | name], _} ->
        holds?(how, number, scale.(n, List.first(name) || ""))

      {_, [_, a, b | name]} ->
        name = List.first(name) || ""
        number >= scale.(a, name) and number <= scale.(b, name)

      _ ->
        nil
    end
  end

  def compare(_text, _number, _opts), do: nil

  defp run_comparison(text) do
    Regex.run(
      ~r/^(#{@comparisons}) ?(#{@number})(?: ?(#{@unit})\b)?#{@words}$/,
      text
    )
  end

  defp run_span(text) do
    Regex.run(
      ~r/^(?:between )?(#{@number}) ?(?:\.\.|to|and|-) ?(#{@number})(?: ?(#{@unit})\b)?#{@words}$/,
      text
    )
  end

  defp holds?(how, a, b) when how in ["<", "less than", "fewer than"], do: a < b
  defp holds?(how, a, b) when how in [">", "more than", "greater than"], do: a > b
  defp holds?(how, a, b) when how in [">=", "at least"], do: a >= b
  defp holds?(how, a, b) when how in ["=", "==", "exactly"], do: a == b
  defp holds?(_at_most, a, b), do: a <= b

  defp number(text) do
    case text |> String.trim_leading("+") |> Integer.parse() do
      {n, ""} -> n
      _ -> text |> String.trim_leading("+") |> Float.parse() |> elem(0)
    end
  end
end

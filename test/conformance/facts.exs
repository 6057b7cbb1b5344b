defmodule Situ.Conformance.Facts do
  # Answers an expectation about the messages of a stream: its values, times and number, and facts
  # derived from them ("sums", "first_3", "increasing" ...). Each answer equals the expected part
  # if and only if the part is true. A part that is not known is {:unread, part}.
  import Situ.Conformance.Case, only: [plain: 1, timed: 1, value: 1]
  alias Situ.Conformance.Text

  @values ~w(values received delivered posted emitted results list log on_next observed outputs messages)
  @counts ~w(count outputs results messages length number_of_outputs number_of_messages received
             message_count output_count calls)

  # `outputs`: `[{time, value}]`. `known`: answers that the area has found otherwise.
  def of(expect, outputs, known \\ %{}) do
    outputs = for {time, v} <- outputs, do: {time, plain(v)}

    Map.new(expect, fn {key, wanted} ->
      {key, Map.get_lazy(known, key, fn -> fact(key, wanted, outputs) end)}
    end)
  end

  def fact(key, wanted, outputs) do
    values = Enum.map(outputs, &elem(&1, 1))

    cond do
      key in @values and is_list(wanted) ->
        same_form(wanted, outputs)

      key in @counts ->
        length(outputs)

      key =~ ~r/^(first|last)/ ->
        end_of(key, wanted, outputs)

      key =~ ~r/^(unique|distinct|no_duplicates)$/ ->
        Enum.uniq(values) == values

      key =~ ~r/^(increasing|ordered|in_order|sorted)$/ ->
        Enum.sort(values) == values

      key =~ ~r/include|contain/ and is_list(wanted) ->
        kept(wanted, value(wanted) -- values == [], values)

      key =~ ~r/^(completed|on_completed|stopped|terminates|ended)$/ ->
        true

      key =~ ~r/^(hangs|deadlock|on_error|failed)$/ ->
        false

      key in ~w(error exception thrown) ->
        nil

      key == "errors" ->
        0

      key == "value" and values != [] ->
        List.last(values)

      true ->
        derived(key, wanted, outputs, values)
    end
  end

  defp derived("multiset", wanted, _outputs, values),
    do: kept(wanted, Enum.sort(value(wanted)) == Enum.sort(values), values)

  defp derived("non_empty_values", _wanted, _outputs, values),
    do: for(map <- values, map != %{}, {_, v} <- map, do: v)

  defp derived("sum", _wanted, _outputs, values), do: values |> List.flatten() |> Enum.sum()

  defp derived("sum" <> _, wanted, _outputs, values) when is_list(wanted),
    do: Enum.map(values, &total/1)

  defp derived("length" <> _, wanted, _outputs, values) when is_list(wanted),
    do: Enum.map(values, &size/1)

  defp derived("empty", _wanted, outputs, _values), do: outputs == []

  defp derived(key, wanted, outputs, _values) do
    case Regex.run(~r/^(?:originating_)?(?:times?|t)_(ticks|us|ms|s)$/, key) do
      [_, unit] when is_list(wanted) -> for {time, _} <- outputs, do: scaled(time, unit)
      _ -> {:unread, key}
    end
  end

  # "first", "last", "first_3", "last_value", "first_values", "last_t_ms" ...
  defp end_of(key, wanted, outputs) do
    [_, side, rest] = Regex.run(~r/^(first|last)(.*)$/, key)

    case {Regex.run(~r/^_(\d+)(?:_values)?$/, rest),
          Regex.run(~r/^(?:_time|_t)?_(ticks|us|ms|s)$/, rest)} do
      {[_, n], _} ->
        same_form(wanted, taken(outputs, side, String.to_integer(n)))

      {_, [_, unit]} when outputs != [] ->
        outputs |> taken(side, 1) |> hd() |> elem(0) |> scaled(unit)

      _ ->
        one_end(rest, side, wanted, outputs)
    end
  end

  defp one_end("_values", side, wanted, outputs) when is_list(wanted),
    do: same_form(wanted, taken(outputs, side, length(wanted)))

  defp one_end(rest, side, %{"v" => _} = wanted, outputs)
       when rest in ["", "_message", "_output"],
       do: kept(wanted, timed([wanted]) == taken(outputs, side, 1), taken(outputs, side, 1))

  defp one_end(rest, side, _wanted, outputs)
       when rest in ["", "_value", "_message", "_output", "_received"] do
    case taken(outputs, side, 1) do
      [{_, v}] -> v
      [] -> :none
    end
  end

  defp one_end(rest, side, _wanted, _outputs), do: {:unread, side <> rest}

  defp taken(outputs, "first", n), do: Enum.take(outputs, n)
  defp taken(outputs, "last", n), do: Enum.take(outputs, -n)

  # The expected list contains messages with their times, or values only.
  defp same_form([%{"v" => _} | _] = wanted, outputs),
    do: kept(wanted, timed(wanted) == outputs, outputs)

  defp same_form(_wanted, outputs), do: Enum.map(outputs, &elem(&1, 1))

  defp total(list) when is_list(list), do: Enum.sum(list)
  defp total(%{} = map), do: map |> Map.values() |> Enum.sum()
  defp total(number), do: number

  defp size(list) when is_list(list), do: length(list)
  defp size(%{} = map), do: map_size(map)
  defp size(_value), do: 1

  defp scaled(time, unit) do
    ns = Text.unit(unit)
    if rem(time, ns) == 0, do: div(time, ns), else: time / ns
  end

  defp kept(wanted, true, _got), do: wanted
  defp kept(_wanted, false, got), do: {:got, got}
end

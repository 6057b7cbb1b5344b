defmodule Situ.Query.Merge do
  @moduledoc false
  # Merges the events of several streams in the order of time; changes at the same time are returned together.

  @type event :: {Situ.Time.t(), value :: term(), latency :: integer()}
  @type change :: {name :: String.t(), {value :: term(), latency :: integer()} | :expired}

  @doc "Returns an enumerable of `{time, changes}`; with `hold`, a value expires if no message follows for that long."
  @spec merge_events([{String.t(), Enumerable.t()}], pos_integer() | nil) :: Enumerable.t()
  def merge_events(streams, hold) do
    Stream.resource(
      fn ->
        heads =
          for {name, events} <- streams,
              head = next_head(name, suspend_after_each(events), hold, nil),
              do: head

        Enum.sort_by(heads, &head_time/1)
      end,
      &merge_step(&1, hold),
      fn _ -> :ok end
    )
  end

  defp suspend_after_each(enumerable),
    do: &Enumerable.reduce(enumerable, &1, fn item, _ -> {:suspend, item} end)

  # A head is the next change of a stream and a continuation that reads the following one.
  defp next_head(name, rest, hold, since) do
    case rest.({:cont, nil}) do
      {:suspended, {time, value, latency}, rest} ->
        if hold != nil and since != nil and time - since > hold,
          do: {since + hold, name, :expired, {:held, {time, value, latency}, rest}},
          else: {time, name, {value, latency}, {:read, rest}}

      {_, _} ->
        if hold != nil and since != nil, do: {since + hold, name, :expired, :done}
    end
  end

  defp following_head({time, name, _, {:read, rest}}, hold), do: next_head(name, rest, hold, time)

  defp following_head({_, name, _, {:held, {time, value, latency}, rest}}, _hold),
    do: {time, name, {value, latency}, {:read, rest}}

  defp following_head({_, _, _, :done}, _hold), do: nil

  defp head_time({time, _, _, _}), do: time

  defp merge_step([], _hold), do: {:halt, []}

  defp merge_step([first | _] = heads, hold) do
    {now, later} = Enum.split_while(heads, &(head_time(&1) == head_time(first)))
    following = for head <- now, next = following_head(head, hold), do: next
    {same, _} = Enum.split_with(following, &(head_time(&1) == head_time(first)))
    changes = for {_, name, change, _} <- now, do: {name, change}

    # If a stream has several changes at one time (edges of annotations), the last one counts.
    if same == [],
      do: {[{head_time(first), changes}], Enum.sort_by(following ++ later, &head_time/1)},
      else: merge_same_time(changes, following, later, first, hold)
  end

  defp merge_same_time(changes, following, later, first, hold) do
    {[{_, more}], heads} = merge_step(Enum.sort_by(following ++ later, &head_time/1), hold)
    {[{head_time(first), changes ++ more}], heads}
  end
end

defmodule Situ.Studio.Recordings.ExpressionReader do
  @moduledoc false
  # Reads derived streams. The position of a time in a derived stream is the sum of its ordinals in the streams that the
  # expression names. Thus a derived message has as many positions as there are messages at its time.
  alias Situ.{Error, Expression, Message, Recording, Store}
  alias Situ.Expression.Operators
  alias Situ.Store.{Query, StreamInfo}

  @spec seek_position(Recording.t(), StreamInfo.t(), Situ.Time.t()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def seek_position(recording, %{extra: %{bases: bases}}, time) do
    with {:ok, start} <- seek_start(recording, bases, time), do: {:ok, start.position}
  end

  # A start is a time with its ordinals in the streams.
  defp seek_start(recording, bases, time) do
    with {:ok, ordinals} <- Error.map_ok(bases, &Query.seek_ordinal(recording, &1, time)),
         do: {:ok, %{time: time, ordinals: ordinals, position: Enum.sum(ordinals)}}
  end

  @spec latest_at(Recording.t(), StreamInfo.t(), Situ.Time.t()) ::
          {:ok, Message.t() | nil} | {:error, Error.t()}
  def latest_at(recording, %{extra: %{bases: bases, expression: expression}}, time) do
    with {:ok, found} <- Error.map_ok(bases, &Store.latest_at(recording, &1, time)) do
      case for(
             {%{name: name}, %Message{} = m} <- Enum.zip(bases, found),
             into: %{},
             do: {name, m}
           ) do
        none when none == %{} -> {:ok, nil}
        env -> {:ok, evaluate_message(expression, env, newest(env).originating_time, [])}
      end
    end
  end

  defp newest(messages), do: messages |> Map.values() |> Enum.max_by(& &1.originating_time)

  @spec read_messages(
          Recording.t(),
          StreamInfo.t(),
          {position :: non_neg_integer(), Situ.Time.t() | :unbounded, limit :: pos_integer()},
          keyword()
        ) :: {:ok, [Message.t()], non_neg_integer()} | {:error, Error.t()}
  def read_messages(recording, %{extra: %{bases: [base]} = extra}, {ordinal, to, limit}, opts) do
    with {:ok, messages, next} <- Query.read_batch(recording, base, ordinal, to, limit, opts) do
      evaluate =
        &evaluate_message(extra.expression, %{base.name => &1}, &1.originating_time, opts)

      {:ok, Enum.map(messages, evaluate), next}
    end
  end

  def read_messages(recording, %{extra: %{bases: bases} = extra}, {position, to, limit}, opts) do
    # A start may be as many messages before the position as there are streams.
    window = [to: to, limit: limit + length(bases) + 1, envelopes: opts[:envelopes] || false]

    with {:ok, start} <- find_start(recording, bases, position),
         {:ok, all} <- read_bases(recording, bases, start, window) do
      {before, later} = Enum.split_while(all, fn {time, _, _} -> time < start.time end)

      rows =
        later
        |> Stream.chunk_by(&elem(&1, 0))
        |> Stream.transform({put_latest(%{}, before), start.position}, fn now, {env, at} ->
          {env, next} = {put_latest(env, now), at + length(now)}
          evaluate = fn -> evaluate_message(extra.expression, env, elem(hd(now), 0), opts) end
          {if(next > position, do: [{evaluate.(), next}], else: []), {env, next}}
        end)
        |> Enum.take(limit)

      {_, next} = List.last(rows) || {nil, position}
      {:ok, for({message, _} <- rows, do: message), next}
    end
  end

  # Finds a time whose position is at most as many messages before `position` as there are streams.
  defp find_start(recording, bases, position) do
    times = for %{first: first, last: last} when first != nil <- bases, do: {first, last}
    {from, to} = {Enum.min(for({t, _} <- times, do: t), fn -> 0 end), max_last(times)}

    with {:ok, low} <- seek_start(recording, bases, from),
         {:ok, high} <- seek_start(recording, bases, to + 1),
         {:ok, low, high} <- extend_high(recording, bases, low, high, position),
         do: narrow_start(recording, bases, low, high, {position, 0})
  end

  defp max_last(times), do: Enum.max(for({_, t} <- times, do: t), fn -> 0 end)

  # Messages may have arrived since the bases were described.
  defp extend_high(recording, bases, low, %{position: highest} = high, position)
       when highest <= position do
    later = high.time + max(high.time - low.time, 1_000_000_000)

    case seek_start(recording, bases, later) do
      {:ok, %{position: ^highest}} -> {:ok, high, high}
      {:ok, extended} -> extend_high(recording, bases, high, extended, position)
      error -> error
    end
  end

  defp extend_high(_recording, _bases, low, high, _position), do: {:ok, low, high}

  # Interpolation finds the time from both sides within a few steps if the rate is steady, and bisection always does.
  defp narrow_start(recording, bases, low, high, {position, step}) do
    if low.position >= position or high.position - low.position <= length(bases) or
         high.time - low.time <= 1 do
      {:ok, low}
    else
      with {:ok, middle} <-
             seek_start(recording, bases, guess_time(low, high, {position, length(bases)}, step)) do
        if middle.position <= position,
          do: narrow_start(recording, bases, middle, high, {position, step + 1}),
          else: narrow_start(recording, bases, low, middle, {position, step + 1})
      end
    end
  end

  defp guess_time(low, high, {position, n}, step) do
    case rem(step, 3) do
      0 -> interpolate_time(low, high, position)
      1 -> interpolate_time(low, high, position + n)
      2 -> div(low.time + high.time, 2)
    end
  end

  defp interpolate_time(low, high, position) do
    span = high.time - low.time
    part = div(span * (position - low.position), high.position - low.position)
    low.time + (part |> max(1) |> min(span - 1))
  end

  # Reads the message in force at the start, too. Returns `{time, name, message}` in the order of time.
  defp read_bases(recording, bases, start, window) do
    lists =
      bases
      |> Enum.zip(start.ordinals)
      |> Error.map_ok(fn {base, ordinal} ->
        with {:ok, messages} <-
               Store.read(recording, base, [index: max(ordinal - 1, 0)] ++ window),
             do: {:ok, for(m <- messages, do: {m.originating_time, base.name, m})}
      end)

    with {:ok, lists} <- lists, do: {:ok, lists |> Enum.concat() |> Enum.sort_by(&elem(&1, 0))}
  end

  defp put_latest(env, rows), do: for({_, name, m} <- rows, into: env, do: {name, m})

  # Evaluates an expression at a time, given the latest message of each stream.
  defp evaluate_message(expression, messages, time, opts) do
    newest = newest(messages)

    if opts[:envelopes],
      do: %{newest | data: nil, originating_time: time},
      else: %{newest | data: evaluate(expression, messages, time), originating_time: time}
  end

  defp evaluate(expression, messages, time) do
    env =
      for {name, m} <- messages, reduce: %{} do
        env ->
          env
          |> Map.put(name, Operators.to_plain(m.data))
          |> Map.put("latency(#{name})", m.creation_time - m.originating_time)
          |> Map.put("age(#{name})", time - m.originating_time)
      end

    Expression.eval(expression, env)
  end
end

defmodule Situ.Studio.Source.DerivedStreams do
  @moduledoc """
  Adds derived streams to a source, which are computed when they are read. A stream called `= EXPRESSION` has a message
  at the time of every message of the streams that the expression names. Its value is the result of the expression
  (`Situ.Expression`) for the latest message of each of these streams. The name is the complete definition, so
  layouts and links can contain derived streams.

      iex> history = Situ.Studio.History.new(live: false)
      iex> message = %Situ.Message{data: 20, originating_time: 5}
      iex> :ok = Situ.Studio.History.put(history, "Level", message, 8)
      iex> source = Situ.Studio.Source.DerivedStreams.wrap({Situ.Studio.Source.History, history})
      iex> {:ok, message} = Situ.Studio.Source.call(source, :latest_at, ["= Level * 2 + 1", 9])
      iex> {message.originating_time, message.data}
      {5, 41}
  """
  @behaviour Situ.Studio.Source

  alias Situ.{Error, Expression, Message}
  alias Situ.Expression.Operators
  alias Situ.Studio.{Source, StreamInfo}
  alias Situ.Studio.Draw.{Bins, WindowMessages}

  # The shape of a derived stream is determined from this many values.
  @looked_at 16
  @most 200_000

  @enforce_keys [:source]
  defstruct [:source]

  @type t :: %__MODULE__{source: Source.t()}

  @doc "Wraps a source to add derived streams."
  @spec wrap(Source.t()) :: Source.t()
  def wrap(source), do: {__MODULE__, %__MODULE__{source: source}}

  @doc """
  Returns whether a name is that of a derived stream.

      iex> Situ.Studio.Source.DerivedStreams.derived_name?("= a + 1")
      true
  """
  @spec derived_name?(String.t()) :: boolean()
  def derived_name?(name), do: String.starts_with?(name, "= ")

  @doc """
  Builds the information on the derived stream of an expression. Errors: `:bad_expression`, `:no_stream`, `:constant`
  (the expression names no stream).
  """
  @spec derive_stream(Source.t(), String.t()) :: {:ok, StreamInfo.t()} | {:error, Error.t()}
  def derive_stream(source, text) do
    name = "= " <> String.trim(text)

    with {:ok, _} <- parse_name(name),
         {:ok, infos} <- Source.call(source, :streams, []),
         {:ok, bases} <- fetch_bases(name, infos),
         do: {:ok, build_stream_info(source, name, bases)}
  end

  defp fetch_bases("= " <> text, infos) do
    known = Map.new(infos, &{&1.name, &1})
    names = text |> Expression.parse!() |> Expression.names()

    case Enum.reject(names, &is_map_key(known, &1)) do
      [] -> {:ok, Enum.map(names, &known[&1])}
      [missing | _] -> {:error, unknown_stream_error(missing)}
    end
  end

  defp unknown_stream_error(name) do
    Error.new(:no_stream, "unknown stream #{inspect(name)}",
      fix: "put names that contain dots in backticks: `Room.Level`"
    )
  end

  defp build_stream_info(source, name, bases) do
    firsts = for %{first: first} when first != nil <- bases, do: first
    lasts = for %{last: last} when last != nil <- bases, do: last
    {first, last} = {Enum.max(firsts, fn -> nil end), Enum.max(lasts, fn -> nil end)}

    %StreamInfo{
      name: name,
      type: "derived",
      shape: if(first && last, do: detect_shape(source, name, first, last), else: :value),
      first: first,
      last: last,
      count: bases |> Enum.map(& &1.count) |> Enum.sum()
    }
  end

  defp detect_shape(source, name, first, last) do
    values =
      for i <- 0..(@looked_at - 1),
          time = first + div((last - first) * i, @looked_at - 1),
          {:ok, %{data: data}} when data != nil <- [Source.call(source, :latest_at, [name, time])],
          do: data

    case values |> Enum.map(&StreamInfo.shape_of/1) |> Enum.uniq() do
      [shape] -> shape
      _ -> :value
    end
  end

  @impl true
  def extent(%{source: source}), do: Source.call(source, :extent, [])

  @impl true
  def streams(%{source: source}), do: Source.call(source, :streams, [])

  @impl true
  def damage(%{source: source}), do: Source.list_damage(source)

  @impl true
  def wanted(%{source: source}, streams),
    do: Source.request_streams(source, streams |> Enum.flat_map(&base_names/1) |> Enum.uniq())

  defp base_names("= " <> _ = name) do
    case parse_name(name) do
      {:ok, expression} -> Expression.names(expression)
      {:error, _} -> []
    end
  end

  defp base_names(name), do: [name]

  @impl true
  def series(derived, "= " <> _ = name, from, to, bin) do
    with {:ok, messages, _more} <- messages(derived, name, from, to, @most) do
      {before, later} =
        WindowMessages.surrounding_messages(
          {__MODULE__, derived},
          name,
          {from, to},
          length(messages)
        )

      points =
        Enum.flat_map(
          before ++ messages ++ later,
          &Bins.value_points(&1.originating_time, &1.data)
        )

      {points, raw?} = Bins.fold_points(points, bin, max(div(to - from, bin), 2) + 16)
      {:ok, points, raw?}
    end
  end

  def series(%{source: source}, name, from, to, bin),
    do: Source.call(source, :series, [name, from, to, bin])

  @impl true
  def summary(_derived, "= " <> _, _from, _to, _bins), do: :none

  def summary(%{source: source}, name, from, to, bins),
    do: Source.fetch_summary(source, name, from, to, bins)

  @impl true
  def sample(derived, "= " <> _ = name, from, to, n) do
    messages =
      for i <- 1..n//1,
          {:ok, message} <- [latest_at(derived, name, from + div((to - from) * i, n))],
          message.originating_time >= from,
          uniq: true,
          do: message

    # There may be other messages between these, so no two of them have adjacent positions.
    {:ok, Enum.with_index(messages, &{2 * &2, &1})}
  end

  def sample(%{source: source}, name, from, to, n),
    do: Source.sample_messages(source, name, from, to, n)

  @impl true
  def marks(derived, "= " <> _ = name, from, to, limit) do
    with {:ok, messages, more} <- messages(derived, name, from, to, limit),
         do: {:ok, for(m <- messages, do: {m.originating_time, Message.latency(m)}), more}
  end

  def marks(%{source: source}, name, from, to, limit),
    do: Source.call(source, :marks, [name, from, to, limit])

  @impl true
  def messages(%{source: source}, "= " <> _ = name, from, to, limit) do
    with {:ok, expression} <- parse_name(name),
         names = Expression.names(expression),
         {:ok, read} <- read_streams(source, names, from, to, limit) do
      env =
        for name <- names,
            {:ok, m} <- [latest_before(source, name, from)],
            into: %{},
            do: {name, m}

      all = for {name, messages, _} <- read, m <- messages, do: {m.originating_time, name, m}

      {messages, _} =
        all
        |> Enum.sort_by(fn {time, name, _} -> {time, name} end)
        |> Enum.chunk_by(&elem(&1, 0))
        |> Enum.map_reduce(env, fn [{time, _, _} | _] = now, env ->
          env = Enum.reduce(now, env, fn {_, name, m}, env -> Map.put(env, name, m) end)
          {evaluate_message(expression, env, time), env}
        end)

      cut = if Enum.any?(read, &(elem(&1, 2) == :more)), do: :more, else: :all

      if length(messages) > limit,
        do: {:ok, Enum.take(messages, limit), :more},
        else: {:ok, messages, cut}
    end
  end

  def messages(%{source: source}, name, from, to, limit),
    do: Source.call(source, :messages, [name, from, to, limit])

  defp read_streams(source, names, from, to, limit) do
    Enum.reduce_while(names, {:ok, []}, fn name, {:ok, read} ->
      case Source.call(source, :messages, [name, from, to, limit]) do
        {:ok, messages, more} -> {:cont, {:ok, [{name, messages, more} | read]}}
        error -> {:halt, error}
      end
    end)
  end

  defp latest_before(source, name, time), do: Source.call(source, :latest_at, [name, time - 1])

  @impl true
  def latest_at(%{source: source}, "= " <> _ = name, time) do
    with {:ok, expression} <- parse_name(name) do
      found =
        for name <- Expression.names(expression),
            do: {name, Source.call(source, :latest_at, [name, time])}

      case Enum.find(found, &match?({_, {:error, _}}, &1)) do
        {_, error} ->
          error

        nil ->
          combine_latest(expression, for({name, {:ok, message}} <- found, do: {name, message}))
      end
    end
  end

  def latest_at(%{source: source}, name, time), do: Source.call(source, :latest_at, [name, time])

  defp combine_latest(_expression, []), do: :none

  defp combine_latest(expression, found) do
    time = found |> Enum.map(fn {_, m} -> m.originating_time end) |> Enum.max()
    {:ok, evaluate_message(expression, Map.new(found), time)}
  end

  @impl true
  def next_after(%{source: source} = derived, "= " <> _ = name, time) do
    with {:ok, expression} <- parse_name(name) do
      times =
        for name <- Expression.names(expression),
            {:ok, message} <- [Source.call(source, :next_after, [name, time])],
            do: message.originating_time

      if times == [], do: :none, else: latest_at(derived, name, Enum.min(times))
    end
  end

  def next_after(%{source: source}, name, time),
    do: Source.call(source, :next_after, [name, time])

  defp parse_name("= " <> text) do
    with {:ok, expression} <- Expression.parse(text) do
      if Expression.names(expression) == [],
        do:
          {:error,
           Error.new(:constant, "the expression names no stream",
             fix: "name one, such as `Room.Level` (in backticks if the name contains dots)"
           )},
        else: {:ok, expression}
    end
  end

  # Evaluates an expression at a time, given the latest message of each stream.
  defp evaluate_message(expression, messages, time) do
    env =
      for {name, m} <- messages, reduce: %{} do
        env ->
          env
          |> Map.put(name, Operators.to_plain(m.data))
          |> Map.put("latency(#{name})", m.creation_time - m.originating_time)
          |> Map.put("age(#{name})", time - m.originating_time)
      end

    newest = messages |> Map.values() |> Enum.max_by(& &1.originating_time)
    %{newest | data: Expression.eval(expression, env), originating_time: time}
  end
end

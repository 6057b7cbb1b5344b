defmodule WindowFixture do
  @moduledoc false
  # Random recordings for the comparison of every pixel column with the messages: numbers of every
  # magnitude, missing values, states, maps, intervals and gaps. SEED=N makes others. A file
  # next to them contains the data.
  alias Situ.Store.Writer

  @t0 1_767_225_600_000_000_000
  @second 1_000_000_000
  @states [:idle, :moving, :turning, :held]

  # {name, type, kind}; streams of different groups have separate panels.
  @streams [
    {"A.Tiny", :float, :tiny},
    {"B.Huge", :float, :huge},
    {"C.Offset", :float, :offset},
    {"D.Integer", :integer, :integer},
    {"E.Missing", {:optional, :float}, :missing},
    {"F.Odd", :any, :odd},
    {"G.Map", {:map, :string, :float}, :map},
    {"H.Boolean", :boolean, :boolean},
    {"I.State", {:in, @states}, :state},
    {"J.Flags", {:map, :string, :boolean}, :flags},
    {"K.Interval", Situ.Interval, :interval}
  ]

  # Creates the recordings window1.0000 and so on.
  def record(folder, told) do
    windows = String.to_integer(System.get_env("SITU_WINDOWS") || "24")

    seed = String.to_integer(System.get_env("SEED") || "581681")
    :rand.seed(:exsss, {seed, 3, 7})

    all =
      for i <- 1..min(2 + div(windows, 250), 20) do
        length = round(@second * :math.pow(600, :rand.uniform()))
        streams = for {name, type, kind} <- @streams, do: {name, type, kind, rows(kind, length)}
        write("window#{i}", folder, streams, length)

        %{
          "name" => "window#{i}.0000",
          "length" => length,
          "streams" =>
            for {name, _type, kind, {period, rows}} <- streams do
              %{
                "name" => name,
                "kind" => kind,
                "period" => period,
                "rows" => for({t, value} <- rows, do: [t, to_json(value)])
              }
            end
        }
      end

    told_data = %{"seed" => seed, "windows" => windows, "recordings" => all}
    File.write!(told, Situ.JSON.encode(told_data))
  end

  # Integers are strings, since they may be too large for a number of JavaScript.
  defp to_json(%Situ.Interval{left: left, right: right}), do: [left - @t0, right - @t0]
  defp to_json(value) when is_integer(value), do: Integer.to_string(value)
  defp to_json(value), do: value

  defp write(name, folder, streams, length) do
    {:ok, writer} = Writer.create(name, folder)

    for {stream, type, _kind, {_period, rows}} <- streams do
      {:ok, out} = Writer.stream(writer, stream, type: type)

      messages =
        for {{t, data}, n} <- Enum.with_index(rows) do
          time = @t0 + t
          %Situ.Message{data: data, originating_time: time, creation_time: time, sequence_id: n}
        end

      {:ok, out} = Writer.append(out, messages)
      {:ok, _} = Writer.close_stream(out, @t0 + length)
    end

    :ok = Writer.close(writer)
  end

  # Returns the period (0 if irregular) and `{time, value}` of each message.
  defp rows(kind, length) do
    n =
      round(:math.pow(if(kind == :interval, do: 400, else: 15_000), 0.2 + 0.8 * :rand.uniform()))

    regular? = :rand.uniform() < 0.6
    pause = max(div(length, n), 1)
    holes = for _ <- 1..:rand.uniform(3), do: hole(length)

    times =
      0
      |> Stream.iterate(&(&1 + if(regular?, do: pause, else: wait(pause))))
      |> Stream.take_while(&(&1 < length))
      |> Enum.reject(fn t -> Enum.any?(holes, fn {a, b} -> t > a and t < b end) end)

    {if(regular?, do: pause, else: 0), values(kind, times, pause)}
  end

  defp hole(length) do
    from = :rand.uniform(length)
    {from, from + div(:rand.uniform(length), 8)}
  end

  defp wait(pause), do: max(round(-pause * :math.log(1 - :rand.uniform())), 1)

  defp values(:tiny, times, _), do: scaled(times, -:rand.uniform(300))
  defp values(:huge, times, _), do: scaled(times, :rand.uniform(300))

  defp values(:offset, times, _) do
    base = :math.pow(10, 3 + :rand.uniform(9))
    step = :math.pow(10, -:rand.uniform(4))
    for {t, i} <- Enum.with_index(times), do: {t, base + i * step + :rand.uniform() * step}
  end

  defp values(:integer, times, _) do
    most = round(:math.pow(10, :rand.uniform(17)))
    for t <- times, do: {t, :rand.uniform(most) - div(most, 2)}
  end

  defp values(:missing, times, _) do
    for {t, v} <- scaled(times, 0), do: {t, if(:rand.uniform() < 0.05, do: nil, else: v)}
  end

  defp values(:odd, times, _) do
    for {t, v} <- scaled(times, 2), do: {t, if(:rand.uniform() < 0.03, do: :nan, else: v)}
  end

  defp values(:map, times, _) do
    half = div(List.last([0 | times]), 2)

    for {t, v} <- scaled(times, 1) do
      late = if t > half, do: %{"late" => v / 2}, else: %{}
      {t, Map.merge(%{"first" => v, "second" => -v}, late)}
    end
  end

  defp values(:boolean, times, _), do: held(times, [true, false])
  defp values(:state, times, _), do: held(times, @states)

  defp values(:flags, times, _) do
    [a, b] = for _ <- 1..2, do: held(times, [true, false])
    for {{t, a}, {t, b}} <- Enum.zip(a, b), do: {t, %{"a" => a, "b" => b}}
  end

  # Each interval ends at its message.
  defp values(:interval, times, pause) do
    for t <- times, length = max(div(pause, 2), 2), t > length do
      {t, Situ.Interval.closed(@t0 + t - :rand.uniform(length), @t0 + t)}
    end
  end

  # A random walk with single outliers, times a power of ten.
  defp scaled(times, exponent) do
    factor = :math.pow(10, exponent)

    {rows, _} =
      Enum.map_reduce(times, 0.0, fn t, at ->
        at = at * 0.999 + :rand.uniform() - 0.5
        spike = if :rand.uniform(3_000) == 1, do: 50 * (:rand.uniform() - 0.5), else: 0
        {{t, (at + spike) * factor}, at}
      end)

    rows
  end

  # Values that stay the same for a random number of messages, few or many depending on the
  # stream.
  defp held(times, choices) do
    most = :math.pow(500, :rand.uniform())

    {rows, _} =
      Enum.map_reduce(times, {hd(choices), 0}, fn
        t, {_, 0} ->
          value = Enum.random(choices)
          {{t, value}, {value, round(:math.pow(most, :rand.uniform()))}}

        t, {value, left} ->
          {{t, value}, {value, left - 1}}
      end)

    rows
  end
end

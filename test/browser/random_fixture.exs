defmodule RandomFixture do
  @moduledoc false
  # Random streams, which are new each time and repeatable with SEED. A file next to them contains
  # the data for comparison.
  alias Situ.Store.Writer

  @t0 1_767_225_600_000_000_000
  @second 1_000_000_000
  @states [:idle, :moving, :turning, :held]

  # Creates the recordings random1.0000 and so on, and returns their seed.
  def record(folder, told, recordings) do
    seed =
      String.to_integer(
        System.get_env("SEED") || System.get_env("SITU_SEED") ||
          "#{rem(System.os_time(:millisecond), 1_000_000)}"
      )

    :rand.seed(:exsss, {seed, 1, 1})

    all =
      for i <- 1..recordings do
        length = round(@second * :math.pow(600, :rand.uniform()))
        streams = for kind <- [:number, :number, :boolean, :state, :map], do: stream(kind, length)
        write("random#{i}", folder, streams, length)

        %{
          "name" => "random#{i}.0000",
          "length" => length,
          "streams" =>
            for(
              {{kind, period, rows}, k} <- Enum.with_index(streams),
              do: %{
                "name" => name(kind, k),
                "kind" => kind,
                "period" => period,
                "rows" => Enum.map(rows, &Tuple.to_list/1)
              }
            )
        }
      end

    File.write!(told, Situ.JSON.encode(%{"seed" => seed, "recordings" => all}))
    seed
  end

  defp name(kind, k), do: "R#{k}.#{kind}"

  defp write(name, folder, streams, length) do
    {:ok, writer} = Writer.create(name, folder)

    for {{kind, _, rows}, k} <- Enum.with_index(streams) do
      {:ok, out} = Writer.stream(writer, name(kind, k), type: type(kind))

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

  defp type(:number), do: :float
  defp type(:boolean), do: :boolean
  defp type(:state), do: {:in, @states}
  defp type(:map), do: {:map, :string, :boolean}

  # A period of 0 is the period of an irregular stream.
  defp stream(kind, length) do
    n = round(:math.pow(20_000, 0.2 + 0.8 * :rand.uniform()))
    regular? = :rand.uniform() < 0.6
    pause = max(div(length, n), 1)
    holes = for _ <- 1..:rand.uniform(3), do: hole(length)

    times =
      0
      |> Stream.iterate(&(&1 + if(regular?, do: pause, else: wait(pause))))
      |> Stream.take_while(&(&1 < length))
      |> Enum.reject(fn t -> Enum.any?(holes, fn {a, b} -> t > a and t < b end) end)

    {kind, if(regular?, do: pause, else: 0), values(kind, times)}
  end

  defp hole(length) do
    from = :rand.uniform(length)
    {from, from + div(:rand.uniform(length), 8)}
  end

  defp wait(pause), do: max(round(-pause * :math.log(1 - :rand.uniform())), 1)

  defp values(:number, times),
    do: for(t <- times, do: {t, Float.round(:rand.uniform() * 200 - 100, 3)})

  defp values(:boolean, times), do: held(times, [true, false])
  defp values(:state, times), do: held(times, @states)

  defp values(:map, times) do
    [a, b] = for _ <- 1..2, do: held(times, [true, false])
    for {{t, a}, {t, b}} <- Enum.zip(a, b), do: {t, %{"a" => a, "b" => b}}
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

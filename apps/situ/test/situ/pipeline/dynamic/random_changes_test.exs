defmodule Situ.Pipeline.Dynamic.RandomChangesTest do
  # Two processes make random changes at random moments while messages flow; existing streams must not be affected.
  # The seed is ExUnit's (`mix test --seed`); `SITU_TIMES=50` tries fifty times as many pipelines.
  use ExUnit.Case, async: true

  alias Situ.{Pipeline, Time}
  alias Situ.Fixture.Pass

  @moduletag :capture_log

  @count 2_000
  @changes 25
  @count_per_change div(@count, 2 * @changes)
  @rounds 2 * Situ.Test.Budget.repeat_factor()

  # Builds a source that is slow enough for changes to happen, and streams derived from it.
  defp build(to, changed) do
    fn p ->
      numbers =
        p
        |> Situ.from_enumerable(0..(@count - 1), every: Time.ms(1), name: "Numbers")
        |> Situ.each(&wait_for_change(&1, to, changed), gate())
        |> Situ.map(& &1, async: true)
        |> Situ.name("s0")

      doubled = numbers |> Situ.via(Pass, name: "Pass") |> Situ.name("s1")
      sums = doubled |> Situ.scan(0, &(&1 + &2), async: true) |> Situ.name("s2")
      pairs = numbers |> Situ.join(sums) |> Situ.name("s3")

      for {stream, i} <- Enum.with_index([numbers, doubled, sums, pairs]),
          do: Situ.each(stream, &send(to, {self(), i, &1}), async: true, name: "Sink#{i}")
    end
  end

  # The source must not run ahead, because a pipeline whose sources have ended replies to some changes only at its
  # end.
  defp gate, do: [async: true, policy: Situ.Delivery.throttle(1), name: "Gate"]

  # Every change lets more messages through, so that all changes happen while messages flow.
  defp wait_for_change(number, to, changed) do
    if number == 0, do: send(to, {:gate, self()})

    if rem(number, @count_per_change) == 0,
      do: await_changes(changed, div(number, @count_per_change))
  end

  defp await_changes(changed, n) do
    if :counters.get(changed, 1) < n,
      do: receive(do: (:changed -> await_changes(changed, n))),
      else: :ok
  end

  defp run(changes) do
    me = self()
    settings = [replay: [interval: {0, :unbounded}, speed: :max]]
    changed = :counters.new(1, [])
    {:ok, p} = Pipeline.start(build(me, changed), pipeline: settings)
    assert_receive {:gate, gate}
    answers = changes.(p, fn n -> :counters.add(changed, 1, n) && send(gate, :changed) end)
    result = Pipeline.await(p, 60_000)
    {result, collect(%{}), answers}
  end

  defp collect(seen) do
    receive do
      {_sink, i, value} -> collect(Map.update(seen, i, [value], &[value | &1]))
    after
      0 -> seen
    end
  end

  defp make_changes(p, changed, seed) do
    fn ->
      :rand.seed(:exsss, seed)

      for n <- 1..@changes, Pipeline.state(p) in [:starting, :running] do
        kind = :rand.uniform(11)
        answer = change(kind, p, {elem(seed, 2), n})
        changed.(1)

        if kind < 4,
          do: Process.put(:added, [name_of({elem(seed, 2), n}) | Process.get(:added, [])])

        assert answered?(answer), "#{inspect(seed)}: #{inspect(answer)}"
        {kind, answer}
      end
    end
  end

  defp answered?({:error, %Situ.Error{code: code}}), do: code not in [:request_failed, :crashed]
  defp answered?(_answer), do: true

  defp stream(p), do: "s#{:rand.uniform(4) - 1}" |> then(&Pipeline.stream(p, &1))
  # Returns a name that this process has added, now or earlier.
  defp pick_added(at), do: Enum.random([name_of(at) | Process.get(:added, [])])
  defp name_of({worker, n}), do: "Added#{worker}_#{n}"

  defp change(kind, p, at) when kind in [1, 2] do
    Pipeline.extend(p, fn p ->
      Situ.composite(stream(p), name_of(at), fn stream ->
        stream |> Situ.map(& &1, async: kind == 1) |> Situ.each(& &1, async: true)
      end)
    end)
  end

  defp change(3, p, at) do
    Pipeline.extend(p, fn p ->
      streams = {stream(p), Pipeline.stream(p, "s0")}

      Situ.composite(p, name_of(at), fn _ ->
        Situ.join(elem(streams, 0), elem(streams, 1), Situ.Reproducible.exact())
      end)
    end)
  end

  defp change(kind, p, at) when kind in [4, 5],
    do: Pipeline.remove(p, pick_added(at))

  defp change(6, p, at), do: Pipeline.stop_part(p, pick_added(at))

  defp change(7, p, _at) do
    with {:ok, tap} <- Situ.attach_tap({p, "s#{:rand.uniform(4) - 1}"}, fn _ -> :ok end) do
      for _ <- 0..:rand.uniform(300), do: :erlang.yield()
      Situ.detach_tap(tap)
    end
  end

  # When its owner ends, the tap is removed.
  defp change(8, p, _at) do
    fun = fn -> Situ.attach_tap({p, "s#{:rand.uniform(4) - 1}"}, fn _ -> :ok end) end
    Task.await(Task.async(fun), 60_000)
  end

  defp change(9, p, _at), do: Pipeline.replace(p, "Pass", {Pass, []})
  defp change(10, p, _at), do: GenServer.call(p, {:trace, Time.ms(:rand.uniform(@count))}, 60_000)

  defp change(11, p, _at) do
    with {:ok, paths} <- Pipeline.checkpoint(p, &Map.keys/1, timeout: 50), do: {:ok, paths}
  end

  test "existing streams are not affected by random additions, removals, taps and replacements" do
    {{:ok, _}, undisturbed, []} =
      run(fn _p, changed ->
        changed.(@count)
        []
      end)

    seed = ExUnit.configuration()[:seed]

    for round <- 1..@rounds do
      me = "seed #{seed}, round #{round}"

      {result, seen, answers} =
        run(fn p, changed ->
          1..2
          |> Enum.map(&Task.async(make_changes(p, changed, {seed, round, &1})))
          |> Task.await_many(60_000)
          |> List.flatten()
          |> tap(fn _ -> changed.(@count) end)
        end)

      assert Enum.any?(answers, fn {kind, answer} -> kind < 4 and match?({:ok, _}, answer) end),
             me

      assert {:ok, report} = result, me
      assert report.errors == [], me
      assert Map.keys(seen) == Map.keys(undisturbed), me
      for {i, values} <- undisturbed, do: assert(seen[i] == values, "#{me}: s#{i} differs")

      for edge <- report.snapshot.edges,
          do: assert(edge.emitted == edge.processed + edge.dropped, "#{me}: #{inspect(edge)}")
    end
  end
end

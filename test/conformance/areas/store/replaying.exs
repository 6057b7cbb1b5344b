defmodule Situ.Conformance.Store.Replaying do
  # Stores are replayed in pipelines.
  import Situ.Conformance.Case, only: [all: 2, meant: 3, told: 2, verdict: 2]
  import Situ.Conformance.Store.Tape, except: [told: 0, told: 1]
  alias Situ.Conformance.Facts
  alias Situ.Conformance.Store.Tape
  alias Situ.{Message, Pipeline, Store}

  def run("replay_interval", %{"start" => _} = _params, case, root) do
    [{name, messages} | _] = streams = streams(case)
    path = record(root, streams)

    wrong =
      for %{originating_time: time} <- tl(messages),
          [first | _] = replay(path, name, {time, :unbounded}),
          first.originating_time != time,
          do: {time, first.originating_time}

    all(case, %{
      "first_message_time" =>
        meant(case["expect"]["first_message_time"], ~r/equals? (to )?the start/, wrong == [])
    })
  end

  def run("replay_interval", params, case, root) do
    streams = streams(case)

    other =
      for i <- 0..99, do: %Message{data: :binary.copy("x", 1_024), originating_time: i * ms()}

    streams = if params["other_stream"], do: streams ++ [{"other", other}], else: streams
    [{name, messages} | _] = streams
    path = record(root, streams)
    from = time(params, "start_offset") || time(params, "from") || 0
    to = time(params, "end_offset") || time(params, "to") || :unbounded
    got = replay(path, name, {from, to})
    {first, last} = path |> Store.open!() |> Store.interval()
    inside = Enum.filter(messages, &(&1.originating_time >= from and &1.originating_time <= to))
    range = div(last - first, ms())
    answer = %{"count" => length(got), "store_range_ms" => range}
    values = %{"values" => Enum.map(got, & &1.data), name => Enum.map(got, & &1.data)}
    answer = Map.merge(answer, values)
    answer = if got == [], do: answer, else: Map.merge(answer, ends(got))

    if times(got) == times(inside),
      do: all(case, answer),
      else: {:fail, times(inside), times(got)}
  end

  def run("replay", %{"stores" => n} = params, case, root) do
    [{name, messages} | _] = streams(case)
    paths = for i <- 1..n, do: record(root, [{name, messages}], fn _ -> [] end, "store#{i}")
    test = self()

    {:ok, _} =
      Pipeline.run(fn p ->
        for {path, n} <- Enum.with_index(paths) do
          open = fn p -> p |> Store.importer(path) |> Store.stream(name) |> tell({test, n}) end

          if n > 0 and params["two_in_subpipelines"],
            do: Situ.composite(p, "Sub#{n}", fn p -> open.(p) end),
            else: open.(p)
        end
      end)

    got = Tape.told()
    sums = for n <- 0..(length(paths) - 1), do: Enum.sum(for {^n, m} <- got, do: m.data)
    verdict(case["expect"]["sums"], sums)
  end

  # In real time, no message arrives before its time on the clock of the replay.
  def run("replay", %{"enforce_replay_clock" => true}, case, root), do: in_real_time(case, root)
  def run("replay", %{"real_time" => true}, case, root), do: in_real_time(case, root)

  # A replay returns the recorded messages with their envelopes, including sequence ids and
  # creation times.
  def run("replay", params, case, root) do
    streams = streams(case)
    path = record(root, streams)
    store = Store.open!(path)
    names = params["opened"] || Enum.map(streams, &elem(&1, 0))
    options = [or_empty: params["or_empty"] == true, type: type(params["type"])]
    options = Enum.reject(options, fn {_, value} -> value in [false, nil] end)

    got = for name <- names, do: {name, replay(path, name, {:unbounded, :unbounded}, options)}
    plain = fn messages -> Enum.map(messages, &%{&1 | source_id: nil}) end

    changed =
      for {name, messages} <- got,
          Store.has_stream?(store, name),
          plain.(messages) != plain.(Enum.to_list(Store.messages(store, name))),
          do: name

    values = Map.new(got, fn {name, messages} -> {name, Enum.map(messages, & &1.data)} end)
    if changed == [], do: verdict(case["expect"], values), else: {:fail, [], changed}
  end

  # Messages by number, from the start and from the end, and by time.
  def run("read_index", _params, case, root) do
    store = root |> record(streams(case)) |> Store.open!()

    wrong =
      for {name, messages} <- streams(case),
          count = length(messages),
          {message, i} <- Enum.with_index(messages),
          wanted <- [{message.originating_time, message.data}],
          {:ok, got} <- [
            Store.at(store, name, i),
            Store.at(store, name, i - count),
            Store.latest_at(store, name, message.originating_time),
            Store.first_at(store, name, message.originating_time)
          ],
          {got.originating_time, got.data} != wanted,
          do: {wanted, got}

    if wrong == [], do: by_stream(case, store), else: {:fail, [], wrong}
  end

  def run("progress", _params, case, root) do
    [{name, _} | _] = streams = streams(case)
    path = record(root, streams)
    test = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          :ok = Pipeline.on(p, :completed, &send(test, {:last, &1.snapshot.progress}))
          p |> Store.importer(path) |> Store.stream(name) |> Situ.each(fn _ -> :ok end)
        end,
        []
      )

    samples = sample(p, [])
    last = receive do: ({:last, progress} -> progress)
    all = samples ++ [last]

    steady? = all == Enum.sort(all)

    all(case, %{
      "progress" =>
        told(case["expect"]["progress"] || "", [
          {~r/never decreases, last (?:value|report) (?:is )?exactly 1(?:\.0)?/,
           steady? and last == 1.0},
          {~r/never decreases/, steady?}
        ]),
      "never_decreases" => steady?,
      "final" => last,
      "last" => last
    })
  end

  defp in_real_time(%{"expect" => expect} = case, root) do
    [{name, messages} | _] = streams = streams(case)
    path = record(root, streams)
    test = self()

    {:ok, pipeline} =
      Pipeline.start(
        fn p -> p |> Store.importer(path) |> Store.stream(name) |> tell(test) end,
        pipeline: [replay: [interval: {hd(messages).originating_time, :unbounded}, speed: 1.0]]
      )

    until(fn -> Pipeline.state(pipeline) not in [:building, :starting] end)
    clock = Pipeline.Client.call!(pipeline, :timing).clock

    arrived =
      for _ <- messages do
        message =
          receive do: ({:told, message} -> message), after: (30_000 -> raise("no message"))

        {message, Situ.Clock.now(clock)}
      end

    {:ok, _} = Pipeline.await(pipeline)
    outputs = for {m, _} <- arrived, do: {m.originating_time, m.data}
    spaced? = Enum.all?(arrived, fn {m, at} -> at >= m.originating_time end)

    known =
      for {key, wanted} <- expect, is_boolean(wanted) or is_binary(wanted), into: %{} do
        {key,
         if(is_boolean(wanted),
           do: spaced?,
           else: meant(wanted, ~r/at or after|>=|not before|spaced/, spaced?)
         )}
      end

    all(case, Facts.of(expect, outputs, Map.put(known, "messages_read", length(outputs))))
  end

  defp ends(got) do
    %{
      "first" => hd(got).data,
      "last" => List.last(got).data,
      "first_ms" => div(hd(got).originating_time, ms()),
      "last_ms" => div(List.last(got).originating_time, ms())
    }
  end

  defp sample(p, got) do
    case Pipeline.state(p) do
      :completed ->
        Enum.reverse(got)

      _ ->
        progress =
          try do
            Pipeline.progress(p)
          rescue
            Situ.Error -> nil
          end

        sample(p, if(progress, do: [progress | got], else: got))
    end
  end

  defp type(nil), do: nil
  defp type(name), do: String.to_existing_atom(name)
end

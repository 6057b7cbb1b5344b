defmodule Situ.Conformance.Store do
  # Recordings written, read live, replayed, cut, edited, mended, put together.
  import Situ.Conformance.Case, only: [verdict: 2]
  alias Situ.{Message, Pipeline, Store}
  alias Situ.Store.Writer

  @ms 1_000_000
  @tick 100

  @operations ~w(write_read live_read replay_interval replay close_at progress metadata supplemental dynamic_read
                 schema_evolution crop repair edit add_stream concatenate copy copy_stream second_writer write_envelopes delete)

  def operation?(op), do: String.replace_prefix(op, "store.", "") in @operations

  def check(%{"op" => "store." <> op} = case) do
    {:ok, _} = Application.ensure_all_started(:situ_store)

    root =
      Path.join(
        System.tmp_dir!(),
        "situ-conformance-#{System.pid()}-#{System.unique_integer([:positive])}"
      )

    File.mkdir_p!(root)

    try do
      run(op, case["params"] || %{}, case, root)
    after
      File.rm_rf!(root)
    end
  end

  def check(case), do: {:fail, "an operation of stores", case["op"]}

  # Writing and reading

  defp run("write_read", params, case, root) do
    streams = streams(case)
    large = params["large_messages"] || []
    path = record(root, streams, fn name -> [large: name in large] end)
    store = Store.open!(path)

    read =
      for {name, _} <- streams, into: %{}, do: {name, Enum.to_list(Store.messages(store, name))}

    same = for {name, messages} <- streams, do: envelopes(messages) == envelopes(read[name])

    got =
      Map.new(case["expect"], fn
        {"available_streams", _} ->
          {"available_streams", length(Store.streams(store))}

        {"sum_of_byte_" <> n, _} ->
          {"sum_of_byte_" <> n, sum_of_element(read, large, String.to_integer(n))}

        {"sum", _} ->
          {"sum", read |> Map.values() |> List.flatten() |> Enum.map(& &1.data) |> Enum.sum()}

        {"count", _} ->
          {"count", read |> Map.values() |> List.flatten() |> length()}

        {key, expected} ->
          {key, if(Enum.all?(same), do: expected, else: :different)}
      end)

    if Enum.all?(same), do: verdict(case["expect"], got), else: {:fail, streams, read}
  end

  # The reader is there before the writer runs, and ends when the writer closes the store.
  defp run("live_read", params, case, root) do
    streams = live_streams(params, case)
    [{name, messages} | _] = streams

    root =
      case params do
        %{"store" => "memory"} -> nil
        %{"path" => "relative"} -> Path.relative_to(root, File.cwd!())
        _ -> root
      end

    writer = Pipeline.new(replay: [speed: :max])
    exporter = Store.create(writer, "live", root)
    for {name, messages} <- streams, do: writer |> source(messages) |> Store.write(exporter, name)
    test = self()

    {:ok, reader} =
      Pipeline.start(
        fn p -> p |> Store.importer(exporter.writer.path) |> Store.stream(name) |> tell(test) end,
        []
      )

    :ok = Pipeline.start(writer)
    {:ok, _} = Pipeline.await(writer)
    {:ok, _} = Pipeline.await(reader, 20_000)
    if root == nil, do: Store.delete(exporter.writer.path)
    got = told()

    expect =
      Map.new(case["expect"], fn
        {"sum", sum} -> {{"sum", sum}, Enum.sum(Enum.map(got, & &1.data))}
        {"messages_read", n} -> {{"messages_read", n}, length(got)}
        {"count", n} -> {{"count", n}, length(got)}
        {key, value} -> {{key, value}, value}
      end)

    wrong = for {{_, expected}, actual} <- expect, expected != actual, do: actual

    cond do
      wrong != [] -> {:fail, case["expect"], wrong}
      Enum.map(got, & &1.data) != Enum.map(messages, & &1.data) -> {:fail, messages, got}
      times(got) != times(messages) -> {:fail, times(messages), times(got)}
      true -> :pass
    end
  end

  # Replaying

  defp run("replay_interval", %{"start" => _} = _params, case, root) do
    [{name, messages} | _] = streams = streams(case)
    path = record(root, streams)

    wrong =
      for %{originating_time: time} <- tl(messages),
          [first | _] = replay(path, name, {time, :unbounded}),
          first.originating_time != time,
          do: {time, first.originating_time}

    if wrong == [], do: :pass, else: {:fail, "the first message's time is the start", wrong}
  end

  defp run("replay_interval", params, case, root) do
    streams = streams(case)

    other =
      for i <- 0..99, do: %Message{data: :binary.copy("x", 1_024), originating_time: i * @ms}

    streams = if params["other_stream"], do: streams ++ [{"other", other}], else: streams
    [{name, messages} | _] = streams
    path = record(root, streams)
    from = round((params["start_offset_ms"] || 0) * @ms)
    to = if params["end_offset_ms"], do: round(params["end_offset_ms"] * @ms), else: :unbounded
    got = replay(path, name, {from, to})
    {first, last} = path |> Store.open!() |> Store.interval()
    inside = Enum.filter(messages, &(&1.originating_time >= from and &1.originating_time <= to))
    range = div(last - first, @ms)
    answer = %{"count" => length(got), "store_range_ms" => range}
    wanted = Map.take(case["expect"], Map.keys(answer))

    if times(got) == times(inside),
      do: verdict(wanted, Map.take(answer, Map.keys(wanted))),
      else: {:fail, times(inside), times(got)}
  end

  defp run("replay", params, case, root) do
    [{name, messages} | _] = streams(case)

    paths =
      for n <- 1..params["stores"],
          do: record(root, [{name, messages}], fn _ -> [] end, "store#{n}")

    test = self()

    {:ok, report} =
      Pipeline.run(fn p ->
        for {path, n} <- Enum.with_index(paths) do
          open = fn p -> p |> Store.importer(path) |> Store.stream(name) |> tell({test, n}) end

          if n > 0 and params["two_in_subpipelines"],
            do: Situ.composite(p, "Sub#{n}", fn p -> open.(p) end),
            else: open.(p)
        end
      end)

    got = told()
    _ = report
    sums = for n <- 0..(length(paths) - 1), do: Enum.sum(for {^n, m} <- got, do: m.data)
    verdict(case["expect"]["sums"], sums)
  end

  defp run("close_at", params, case, root) do
    [{name, messages} | _] = streams(case)
    stop = params["pipeline_stop_ms"] * @ms
    {:ok, writer} = Writer.create("closing", root)
    {:ok, stream} = Writer.stream(writer, name)
    {:ok, stream} = Writer.append(stream, messages)
    {:ok, _} = Writer.close_stream(stream, stop)
    :ok = Writer.close(writer)
    [info] = writer.path |> Store.open!() |> Store.streams()
    last = List.last(replay(writer.path, name, {:unbounded, :unbounded}))

    verdict(case["expect"], %{
      "closed_time_ms" => div(info.closed, @ms),
      "last_replayed" => %{"t_ms" => div(last.originating_time, @ms), "v" => last.data}
    })
  end

  defp run("progress", _params, case, root) do
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

    if all == Enum.sort(all) and last == 1.0,
      do: :pass,
      else: {:fail, case["expect"], all}
  end

  # Metadata

  defp run("metadata", params, case, root) do
    streams = streams(case)
    path = record(root, streams)
    store = Store.open!(path)
    infos = Store.streams(store)
    all = Enum.flat_map(streams, fn {name, _} -> Enum.to_list(Store.messages(store, name)) end)
    creation = Enum.map(all, & &1.creation_time)

    range? =
      Store.creation_interval(store) == {Enum.min(creation), Enum.max(creation)} and
        Enum.all?(infos, &(&1.first_creation <= &1.last_creation))

    opened =
      for name <- params["opened"] || [] do
        {name, own} = List.keyfind(streams, name, 0)
        test = self()

        {:ok, report} =
          Pipeline.run(fn p ->
            p |> Store.importer(path) |> Store.stream(name) |> tell(test)
          end)

        got = told()
        info = Enum.find(infos, &(&1.name == name))
        [first | _] = times = times(own)

        report.start_time == first and {info.first, info.last} == {first, List.last(times)} and
          length(got) == (case["expect"]["messages_read"] || length(own))
      end

    if range? and Enum.all?(opened), do: :pass, else: {:fail, case["expect"], {infos, opened}}
  end

  defp run("supplemental", %{"value" => value}, case, root) do
    term = List.to_tuple(value)
    {:ok, writer} = Writer.create("meta", root)
    {:ok, _} = Writer.stream(writer, "WithMeta", metadata: term)
    {:ok, _} = Writer.stream(writer, "NoMeta")
    :ok = Writer.close(writer)
    store = Store.open!(writer.path)

    case {Store.metadata(store, "WithMeta"), Store.metadata(store, "NoMeta"),
          Store.metadata(store, "WithMeta", :integer)} do
      {{:ok, ^term}, {:error, %{code: :no_metadata}}, {:error, %{code: :type_mismatch}}} -> :pass
      other -> {:fail, case["expect"], other}
    end
  end

  defp run("dynamic_read", %{"written" => _}, _case, _root) do
    {:not_applicable, "Elixir's values are immutable: none can refer to itself"}
  end

  defp run("dynamic_read", _params, case, root) do
    values = case["expect"]["values"] || []

    streams =
      for {v, i} <- Enum.with_index(values),
          do: {"Data#{i}", [%Message{data: v, originating_time: 0}]}

    store = root |> record(streams) |> Store.open!()
    got = for {name, _} <- streams, {:ok, %{data: data}} = Store.at(store, name, 0), do: data
    verdict(values, got)
  end

  defp run("schema_evolution", params, case, root) do
    written = struct_module(params["written_members"])
    today = struct_module(params["read_members"])
    [members] = values(case, params)
    data = struct(written, for({name, v} <- members, do: {String.to_atom(name), v}))

    path =
      record(root, [{"data", [%Message{data: data, originating_time: 0}]}], fn _ ->
        [type: written]
      end)

    got =
      Pipeline.run(fn p ->
        test = self()
        _ = test

        p
        |> Store.importer(path)
        |> Store.stream("data", type: today)
        |> Situ.each(fn _ -> :ok end)
      end)

    case {got, case["expect_error"]} do
      {{:error, %{code: :schema_mismatch}}, error} when error != nil ->
        :pass

      {{:ok, _}, nil} ->
        [message] = path |> Store.open!() |> Store.messages("data", type: today) |> Enum.to_list()
        value = for {k, v} <- Map.from_struct(message.data), into: %{}, do: {to_string(k), v}
        verdict(case["expect"]["value"], value)

      {other, _} ->
        {:fail, case["expect"] || case["expect_error"], other}
    end
  end

  # Maintenance

  defp run("crop", params, case, root) do
    path = record(root, streams(case))
    {unit, from, to} = bounds(params)
    {:ok, cropped} = Store.crop(path, {"cropped", root}, from: from * unit, to: to * unit)
    kept = case["expect"]["kept_values"]
    store = Store.open!(cropped)

    got =
      for {name, [%{data: first} | _]} <- streams(case) do
        messages = Enum.to_list(Store.messages(store, name))
        wanted = if is_binary(first), do: Enum.map(kept, &to_string/1), else: kept
        Enum.map(messages, & &1.data) == wanted and Enum.map(messages, & &1.sequence_id) == kept
      end

    if Enum.all?(got), do: :pass, else: {:fail, kept, got}
  end

  # The process that writes is gone without having closed anything.
  defp run("repair", params, case, root) do
    crash = params["simulated_crash_at_ticks"] * @tick
    [{name, messages} | _] = streams(case)
    before = Enum.filter(messages, &(&1.originating_time < crash))

    {pid, monitor} =
      spawn_monitor(fn ->
        {:ok, writer} = Writer.create("crashed", root)
        {:ok, stream} = Writer.stream(writer, name)

        Enum.reduce(before, stream, fn message, stream ->
          elem(Writer.append(stream, [message]), 1)
        end)
      end)

    receive do: ({:DOWN, ^monitor, :process, ^pid, reason} -> :normal = reason)
    path = Path.join(root, "crashed")
    store = Store.open!(path)
    until(fn -> not Store.live?(store) end)
    closed_before = Store.closed?(store)
    {:ok, _} = Store.repair(path)
    repaired = Store.open!(path)
    got = Enum.to_list(Store.messages(repaired, name))

    if closed_before == case["expect"]["closed_before"] and Store.closed?(repaired) and
         envelopes(got) == envelopes(Enum.take(messages, length(got))) and
         length(got) == length(before) and
         Enum.all?(got, &(&1.originating_time < crash)),
       do: :pass,
       else: {:fail, case["expect"], got}
  end

  # Edits of one stream, or of several by name; the streams without any stay what they are.
  defp run("edit", params, case, root) do
    path = record(root, streams(case))
    [first | _] = Enum.map(case["inputs"], & &1["stream"])

    edits =
      case params["edits"] do
        %{} = named -> Map.new(named, fn {name, list} -> {name, Enum.map(list, &edit/1)} end)
        list -> %{(params["stream"] || first) => Enum.map(list, &edit/1)}
      end

    {:ok, edited} = Store.edit(path, {"edited", root}, edits)
    by_stream(case, Store.open!(edited))
  end

  # All of a store, a span of it or some of its streams; envelopes, types and metadata with them.
  defp run("copy" <> _, params, case, root) do
    streams = streams(case)
    meta = fn _ -> if(m = params["supplemental_metadata"], do: [metadata: m], else: []) end
    path = record(root, streams, meta)
    {unit, from, to} = bounds(params)
    span = if from, do: [from: from * unit, to: to * unit], else: []
    names = if params["streams"], do: [streams: params["streams"]], else: []
    {:ok, copied} = Store.copy(path, {"copied", root}, span ++ names)
    {old, new} = {Store.open!(path), Store.open!(copied)}

    kept? = &(from == nil or &1.originating_time in (from * unit)..(to * unit))

    same? =
      Enum.all?(Store.streams(new), fn %{name: name} ->
        Enum.map(Enum.filter(Store.messages(old, name), kept?), &%{&1 | source_id: nil}) ==
          Enum.map(Store.messages(new, name), &%{&1 | source_id: nil})
      end)

    if same?, do: by_stream(case, new), else: {:fail, "the same messages", "others"}
  end

  # One at a time may write to a folder; another of the same name goes to a folder of its own.
  defp run("second_writer", _params, case, root) do
    {:ok, first} = Writer.create("twice", root)
    {:ok, second} = Writer.create("twice", root)
    {:ok, fixed} = Writer.create("fixed", root, versioned: false)
    again = Writer.create("fixed", root, versioned: false)
    for writer <- [first, second, fixed], do: Writer.close(writer)

    case {first.path != second.path, again} do
      {true, {:error, _}} -> :pass
      other -> {:fail, case["expect"] || case["expect_error"], other}
    end
  end

  # Only envelopes were written: times and order without data.
  defp run("write_envelopes", _params, case, root) do
    [{name, messages} | _] = streams(case)
    store = root |> record([{name, messages}], fn _ -> [envelopes: true] end) |> Store.open!()
    got = Enum.to_list(Store.messages(store, name))

    if times(got) == times(messages),
      do: by_stream(%{case | "expect" => Map.delete(case["expect"], name)}, store),
      else: {:fail, times(messages), times(got)}
  end

  # Gone from the disk, and nothing else with it.
  defp run("delete", _params, case, root) do
    path = record(root, streams(case))
    kept = record(root, streams(case), fn _ -> [] end, "other")
    true = Store.exists?(path)
    :ok = Store.delete(path)
    verdict({false, true}, {Store.exists?(path), Store.exists?(kept)})
  end

  defp run("add_stream", params, case, root) do
    [{name, _} | _] = streams = streams(case)
    path = record(root, streams)
    meta = params["supplemental_metadata"]
    add = [{params["new_stream"], [metadata: meta]}]
    {:ok, added} = Store.edit(path, {"added", root}, %{}, add: add)
    {old, new} = {Store.open!(path), Store.open!(added)}

    verdict(
      Map.take(case["expect"], [name, params["new_stream"], "supplemental_metadata", "envelopes"]),
      %{
        name => Enum.map(Store.messages(new, name), & &1.data),
        params["new_stream"] => Enum.map(Store.messages(new, params["new_stream"]), & &1.data),
        "supplemental_metadata" => elem(Store.metadata(new, params["new_stream"]), 1),
        "envelopes" =>
          if(Enum.to_list(Store.messages(old, name)) == Enum.to_list(Store.messages(new, name)),
            do: "unchanged",
            else: "changed"
          )
      }
    )
  end

  defp run("concatenate", _params, case, root) do
    parts =
      case
      |> streams()
      |> Enum.group_by(fn {name, _} -> name |> String.split("/") |> hd() end)
      |> Enum.sort()
      |> Enum.map(fn {store, streams} ->
        streams =
          for {name, messages} <- streams,
              do: {name |> String.split("/") |> List.last(), messages}

        record(root, streams, fn _ -> [] end, store)
      end)

    {:ok, path} = Store.concat(parts, {"whole", root})
    store = Store.open!(path)

    verdict(
      case["expect"],
      Map.new(case["expect"], fn {name, _} ->
        {name, Enum.map(Store.messages(store, name), & &1.data)}
      end)
    )
  end

  # Helpers

  # What the case tells of each stream, of counts and of metadata.
  defp by_stream(case, store) do
    got =
      Map.new(case["expect"] || %{}, fn {key, expected} ->
        cond do
          Store.has_stream?(store, key) -> {key, Enum.map(Store.messages(store, key), & &1.data)}
          key == "sum" -> {key, Enum.sum(all_data(store))}
          key in ["count", "messages"] -> {key, length(all_data(store))}
          key == "available_streams" -> {key, length(Store.streams(store))}
          key == "supplemental_metadata" -> {key, metadata(store)}
          true -> {key, expected}
        end
      end)

    verdict(case["expect"] || %{}, got)
  end

  defp all_data(store) do
    for %{name: name} <- Store.streams(store), m <- Store.messages(store, name), do: m.data
  end

  defp metadata(store) do
    Enum.find_value(Store.streams(store), fn info ->
      case Store.metadata(store, info.name) do
        {:ok, term} -> term
        {:error, _} -> nil
      end
    end)
  end

  defp streams(case) do
    for input <- case["inputs"] || [] do
      messages =
        for {m, i} <- Enum.with_index(input["messages"] || [], 1) do
          %Message{
            data: m["v"],
            originating_time: Situ.Conformance.Case.time(m),
            creation_time: Situ.Conformance.Case.time(m) + 5,
            sequence_id: i
          }
        end

      {input["stream"], messages}
    end
  end

  defp live_streams(%{"message_bytes" => size} = params, _case) do
    data = :binary.copy(<<params["fill"] || 0>>, size)

    messages =
      for i <- 1..params["count"],
          do: %Message{data: data, originating_time: i * @ms, sequence_id: i}

    [{"stream", messages}]
  end

  defp live_streams(_params, case), do: streams(case)

  defp source(p, messages),
    do: Situ.from_enumerable(p, for(m <- messages, do: {m.originating_time, m.data}))

  # Recorded by a pipeline as fast as possible; sequence ids count from 1, creation times are its clock's.
  defp record(root, streams, options \\ fn _ -> [] end, name \\ "store") do
    {:ok, report} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, name, root)

        for {stream, messages} <- streams do
          p |> source(messages) |> Store.write(exporter, stream, options.(stream))
        end

        exporter.writer.path
      end)

    report.result
  end

  defp replay(path, name, interval) do
    test = self()

    {:ok, _} =
      Pipeline.run(
        fn p -> p |> Store.importer(path) |> Store.stream(name) |> tell(test) end,
        pipeline: [replay: [interval: interval, speed: :max]]
      )

    told()
  end

  defp tell(stream, {pid, tag}),
    do: Situ.each(stream, fn _, message -> send(pid, {:told, {tag, message}}) end)

  defp tell(stream, pid), do: Situ.each(stream, fn _, message -> send(pid, {:told, message}) end)

  defp told(got \\ []) do
    receive do
      {:told, message} -> told([message | got])
    after
      0 -> Enum.reverse(got)
    end
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

  defp until(fun, left \\ 500) do
    cond do
      fun.() -> :ok
      left == 0 -> raise "waited in vain"
      true -> Process.sleep(10) && until(fun, left - 1)
    end
  end

  defp envelopes(messages),
    do: for(m <- messages, do: {m.originating_time, m.sequence_id, m.data})

  defp times(messages), do: Enum.map(messages, & &1.originating_time)

  defp sum_of_element(read, large, n) do
    read
    |> Map.take(large)
    |> Map.values()
    |> List.flatten()
    |> Enum.map(&Enum.at(&1.data, n))
    |> Enum.sum()
  end

  defp bounds(%{"from_ticks" => from, "to_ticks" => to}), do: {@tick, from, to}
  defp bounds(%{"from_ms" => from, "to_ms" => to}), do: {@ms, from, to}
  defp bounds(_params), do: {1, nil, nil}

  defp edit(%{"delete" => _} = e), do: {:delete, Situ.Conformance.Case.time(e)}
  defp edit(%{"upsert" => nil} = e), do: {:delete, Situ.Conformance.Case.time(e)}
  defp edit(%{"upsert" => value} = e), do: {:upsert, Situ.Conformance.Case.time(e), value}

  # A struct with these fields, as a program of that day would define it. New fields have defaults.
  defp struct_module(members) do
    name = Module.concat(__MODULE__, "Struct#{:erlang.phash2(members)}")
    fields = for m <- members, do: {String.to_atom(m), default(m)}

    if not Code.ensure_loaded?(name) do
      Module.create(
        name,
        quote(do: defstruct(unquote(Macro.escape(fields)))),
        Macro.Env.location(__ENV__)
      )
    end

    name
  end

  defp default("Double" <> _), do: 0.0
  defp default("Int" <> _), do: 0
  defp default(_), do: nil

  defp values(case, params) do
    case streams(case) do
      [{_, [%{data: data} | _]} | _] -> [data]
      _ -> [Map.new(params["written_members"], &{&1, default(&1)})]
    end
  end
end

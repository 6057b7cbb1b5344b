defmodule Situ.Conformance.Interop do
  # Wire formats: the written text must equal the expected text and must be readable again. Files,
  # sockets and datagrams must return the data that was written.
  import Situ.Conformance.Case
  alias Situ.Bridge.{Datagram, Format, ZeroMQ}
  alias Situ.Conformance.{Facts, Text}

  @interleaved ~r/interleav|alternat|in turn/

  def operation?("format." <> name), do: format(name) != nil
  def operation?(op), do: op in ~w(file_write_then_read zeromq datagram_chunks)

  def check(%{"op" => op} = case) do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    run(op, case)
  end

  defp run("format." <> name, case), do: formatted(format(name), case)
  defp run("file_write_then_read", case), do: file(case["params"], case["expect"])
  defp run("zeromq", case), do: zeromq(case["params"], case["expect"])
  defp run("datagram_chunks", case), do: datagrams(case["params"], case["expect"])

  defp format(name), do: Enum.find(Format.format_names(), &(Atom.to_string(&1) == name))

  # The text of the case has the order of an object's members, which a decoded map does not have.
  defp formatted(format, case) do
    {:ok, time} = Situ.Time.parse(case["params"]["originating_time"])
    value = in_order(case)
    {:ok, bytes} = Format.encode(format, value, time)
    {:ok, {back_time, back}} = Format.decode(format, bytes, objects: :pairs)

    first_of(
      for {key, want} <- case["expect"],
          do:
            expectation(key, want, %{
              format: format,
              bytes: bytes,
              value: value,
              back_time: back_time,
              back: back,
              time: time
            })
    )
  end

  defp in_order(%{"ordered" => {pairs}}) do
    {"params", {params}} = List.keyfind(pairs, "params", 0)
    {"value", value} = List.keyfind(params, "value", 0)
    value(value)
  end

  defp expectation("text", want, at), do: verdict(want, at.bytes)
  defp expectation("round_trip_value", want, at), do: verdict(value(want), plain_maps(at.back))

  defp expectation("round_trip_time", want, at) do
    {:ok, time} = Situ.Time.parse(want)
    verdict(time, at.back_time)
  end

  # Parsing must return the same time, formatting the same text, and no member of an object may
  # hide another.
  defp expectation("round_trip", want, at) do
    {:ok, again} = Format.encode(at.format, at.back, at.back_time)
    whole? = members(at.back) == members(plain_maps(at.back))
    with :pass <- verdict(at.time, at.back_time), do: verdict(want, again == at.bytes and whole?)
  end

  defp expectation("error", _want, _at), do: {:fail, "an error", "none"}
  defp expectation(key, want, _at), do: {:fail, "an expectation that is known", {key, want}}

  defp members({pairs}), do: length(pairs)
  defp members(%{} = map), do: map_size(map)
  defp members(_other), do: 1

  defp plain_maps({pairs}), do: Map.new(pairs, fn {k, v} -> {k, plain_maps(v)} end)
  defp plain_maps(list) when is_list(list), do: Enum.map(list, &plain_maps/1)
  defp plain_maps(other), do: other

  defp first_of(verdicts), do: Enum.find(verdicts, :pass, &(&1 != :pass))

  defp file(params, expect) do
    path =
      Path.join(
        System.tmp_dir!(),
        "situ-conformance-#{System.pid()}-#{System.unique_integer([:positive])}"
      )

    format = format(params["format"])
    interval = ms(params["interval_ms"] || 10)
    replay = [pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]]

    try do
      {:ok, _} =
        Situ.Pipeline.run(
          fn p ->
            p |> written(params, interval) |> Situ.Bridge.File.write(path, format: format)
          end,
          replay
        )

      read = fn p -> Situ.Bridge.File.read(p, path, format: format) end
      all(%{"expect" => expect}, Facts.of(expect, Situ.to_list(read, [times: true] ++ replay)))
    after
      File.rm(path)
    end
  end

  defp written(p, %{"values" => values}, interval),
    do: Situ.from_enumerable(p, Text.range(values), every: interval)

  defp written(p, params, interval),
    do: Situ.from_enumerable(p, 0..(params["count"] - 1)//1, every: interval)

  # A publisher and its subscribers, in separate pipelines, over a socket on this machine.
  defp zeromq(params, expect) do
    me = self()
    topics = topics(params)

    {:ok, sender} =
      Situ.Pipeline.start_link(fn p ->
        socket = ZeroMQ.publisher(p, "tcp://127.0.0.1:0")
        opts = [wait_for: length(topics), listening: me]

        for {topic, values, format} <- topics do
          p
          |> Situ.from_enumerable(values, every: ms(1))
          |> ZeroMQ.publish(socket, [topic: topic, format: format] ++ opts)
        end
      end)

    # All streams report the address of their socket, which must be the same.
    [port | _] = for _ <- topics, do: receive(do: ({:listening, port} -> port))
    address = "tcp://127.0.0.1:#{port}"

    {:ok, receiver} =
      Situ.Pipeline.start_link(fn p ->
        for {topic, _values, format} <- topics do
          p
          |> ZeroMQ.subscribe(address, topic: topic, format: format)
          |> Situ.each(&send(me, {:got, topic, &1}))
        end
      end)

    got = for {topic, values, _} <- topics, do: {topic, for(_ <- values, do: received(topic))}
    Situ.Pipeline.stop(sender)
    Situ.Pipeline.stop(receiver)
    compared(expect["values"] || expect["values_by_topic"], got)
  end

  # One topic, or several: `topics` contains objects with their own values, or names with separate
  # values by name.
  defp topics(%{"topics" => topics} = params) do
    for {topic, i} <- Enum.with_index(topics) do
      case topic do
        %{"topic" => name, "values" => values} ->
          {name, Enum.map(values, &value/1),
           format(topic["format"] || params["format"] || "json")}

        name ->
          {name, params["values"] |> of_topic(name, i) |> Enum.map(&value/1),
           format(params["format"] || "json")}
      end
    end
  end

  defp topics(params),
    do: [
      {params["topic"], Enum.map(params["values"], &value/1), format(params["format"] || "json")}
    ]

  defp of_topic(%{} = by_name, name, _i), do: Map.fetch!(by_name, name)
  defp of_topic([first | _] = lists, _name, i) when is_list(first), do: Enum.at(lists, i)
  defp of_topic(values, _name, _i), do: values

  # In the form of the case: the values of one topic, values by topic, or a list for each topic.
  defp compared(%{} = values, got) do
    want = Map.new(values, fn {topic, values} -> {topic, Enum.map(values, &value/1)} end)
    verdict(want, Map.new(got))
  end

  defp compared([first | _] = lists, got) when is_list(first),
    do: verdict(Enum.map(lists, &Enum.map(&1, fn v -> value(v) end)), Enum.map(got, &elem(&1, 1)))

  defp compared(values, got),
    do: verdict(Enum.map(values, &value/1), Enum.flat_map(got, &elem(&1, 1)))

  defp received(topic) do
    receive do
      {:got, ^topic, value} -> value
    after
      5_000 -> :nothing
    end
  end

  defp datagrams(params, expect) do
    most = params["max_datagram_bytes"]

    payloads =
      for {size, i} <- Enum.with_index(sizes(params)),
          do: :binary.copy(<<i + 1, i + 7>>, div(size, 2) + 1) |> binary_part(0, size)

    sets =
      for {payload, i} <- Enum.with_index(payloads, 1),
          do: Datagram.split_payload(payload, i, most)

    sent =
      sets
      |> lost(params["lost"] || params["lost_chunk"])
      |> arriving(params["arrival"] || "in order")

    # A receiver with room for one set loses interleaved sets, which these cases are about.
    open =
      if to_string(params["arrival"]) =~ @interleaved,
        do: [open: params["sets_at_once"] || 1],
        else: []

    {got, state} =
      Enum.reduce(sent, {[], Datagram.new(open)}, fn chunk, {got, state} ->
        {payload, state} = Datagram.push(state, chunk)
        {got ++ [payload], state}
      end)

    whole = Enum.reject(got, &is_nil/1)

    result = %{
      "chunks" => sets |> Enum.concat() |> length(),
      "chunks_received" => state.received,
      "payload_equal" => whole == payloads,
      "payload" => meant(expect["payload"], ~r/equal|same|whole|identical/, whole == payloads),
      "complete" => whole != [],
      "completed" => whole != [],
      "complete_on_last_chunk" => List.last(got) != nil,
      "completed_payload" => Enum.find_index(payloads, &(&1 in whole)) |> then(&(&1 && &1 + 1)),
      "completed_payloads" => length(whole),
      "sets_started" => state.started,
      "sets_abandoned" => state.abandoned
    }

    all(%{"expect" => expect}, result)
  end

  # One payload, several of one size, or several sizes.
  defp sizes(%{"payloads_bytes" => sizes}), do: sizes

  defp sizes(%{"payload_bytes" => size} = params),
    do: List.duplicate(size, params["payloads"] || 1)

  defp sizes(params), do: Text.unknown!("the size of a payload", params)

  @ordinals ~w(first second third fourth fifth sixth seventh eighth ninth tenth)

  # "the eighth chunk of the first payload", "chunk 8 of payload 1", or a number: a chunk of the first.
  defp lost(sets, nil), do: sets
  defp lost(sets, n) when is_integer(n), do: List.update_at(sets, 0, &List.delete_at(&1, n - 1))

  defp lost(sets, text) do
    case Regex.run(
           ~r/^(?:the )?(?:(\w+) chunk|chunk (\d+)) of (?:the )?(?:(\w+) payload|payload (\d+))$/,
           text
         ) do
      [_ | words] ->
        [chunk, payload] = Enum.reject(words, &(&1 == ""))
        List.update_at(sets, place(payload), &List.delete_at(&1, place(chunk)))

      nil ->
        Text.unknown!("a lost chunk", text)
    end
  end

  defp place("last"), do: -1

  defp place(word) do
    case Integer.parse(word) do
      {n, _} -> n - 1
      :error -> Enum.find_index(@ordinals, &(&1 == word)) || Text.unknown!("an ordinal", word)
    end
  end

  defp arriving(sets, how) do
    cond do
      how =~ ~r/in order|sequential/ and not (how =~ ~r/out of|revers/) ->
        Enum.concat(sets)

      how =~ ~r/revers|backward/ ->
        sets |> Enum.map(&Enum.reverse/1) |> Enum.concat()

      how =~ ~r/shuffl|scrambl|random|out of order/ ->
        :rand.seed(:exsss, {1, 2, 3})
        sets |> Enum.map(&Enum.shuffle/1) |> Enum.concat()

      how =~ ~r/duplicat|twice/ ->
        sets |> Enum.map(fn set -> Enum.flat_map(set, &[&1, &1]) end) |> Enum.concat()

      how =~ @interleaved ->
        sets |> Enum.zip() |> Enum.flat_map(&Tuple.to_list/1)

      true ->
        Text.unknown!("an order of arrival", how)
    end
  end
end

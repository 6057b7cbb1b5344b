defmodule Situ.Conformance.Store.Contents do
  # The facts about a store's streams: times, types, metadata, and reading old data with current
  # types.
  import Situ.Conformance.Case,
    only: [all: 2, error_fits?: 2, meant: 3, plain: 1, told: 2, verdict: 2]

  import Situ.Conformance.Store.Tape, except: [told: 0, told: 1]
  alias Situ.{Message, Pipeline, Store}
  alias Situ.Store.{StreamInfo, Writer}

  def run("metadata", params, case, root) do
    streams = streams(case)
    path = written(root, streams)
    store = Store.open!(path)
    infos = Store.streams(store)
    all = Enum.flat_map(streams, fn {name, _} -> Enum.to_list(Store.messages(store, name)) end)
    creation = Enum.map(all, & &1.creation_time)

    {left, right} = Store.creation_interval(store)

    times = fn name -> Enum.to_list(Store.messages(store, name)) end

    played = for name <- params["opened"] || [], do: played(path, name)

    came = %{
      "creation_range_left" => left,
      "creation_range_right" => right,
      "replay_start" => played |> Enum.map(&elem(&1, 0)) |> Enum.min(fn -> nil end),
      "replay_end" => played |> Enum.map(&elem(&1, 1)) |> Enum.max(fn -> nil end)
    }

    # Returns "source0's first creation time" and similar texts if the value is correct.
    told =
      for {key, text} when is_binary(text) <- case["expect"],
          Map.has_key?(came, key),
          into: %{} do
        {key,
         told(text, [
           {~r/(\w+)'s (first|last) (creation|originating) time/,
            fn [name, which, kind] -> came[key] == point(times.(name), which, kind) end}
         ])}
      end

    range =
      case["expect"]["creation_range"] &&
        told(case["expect"]["creation_range"], [
          {~r/\[first creation time, last creation time\] of the only stream(?:, not empty)?/,
           left == Enum.min(creation) and right == Enum.max(creation) and left <= right}
        ])

    figures =
      for info <- infos,
          wanted = case["expect"][info.name],
          into: %{},
          do: {info.name, figures(info, wanted)}

    read = Enum.sum(Enum.map(played, &elem(&1, 2)))

    all(
      case,
      %{"messages_read" => read, "creation_range" => range}
      |> Map.merge(told)
      |> Map.merge(figures)
    )
  end

  def run("supplemental", %{"value" => value}, case, root) do
    term = if is_list(value), do: List.to_tuple(value), else: value
    {:ok, writer} = Writer.create("meta", root)
    {:ok, _} = Writer.stream(writer, "WithMeta", metadata: term)
    {:ok, _} = Writer.stream(writer, "NoMeta")
    :ok = Writer.close(writer)
    store = Store.open!(writer.path)
    other = if is_integer(term), do: :string, else: :integer

    {:ok, read} = Store.metadata(store, "WithMeta")
    none? = match?({:error, %{code: :no_metadata}}, Store.metadata(store, "NoMeta"))
    other? = match?({:error, %{code: :type_mismatch}}, Store.metadata(store, "WithMeta", other))
    expect = case["expect"]

    all(case, %{
      "WithMeta" => read,
      "NoMeta" => meant(expect["NoMeta"], ~r/error|none|nothing|missing/, none?),
      "wrong_type" => meant(expect["wrong_type"], ~r/type error|mismatch|error/, other?)
    })
  end

  # The keys of maps are recorded during writing. The stream's info contains the set of them.
  def run(op, _params, case, root) when op in ["supplemental", "distinct_keys"] do
    store = root |> record(streams(case), fn _ -> [keys: true] end) |> Store.open!()

    [%{name: only} | _] = Store.streams(store)

    # The keys are texts, also if the case lists numbers. A key that is no stream is about the first.
    got =
      Map.new(case["expect"], fn {key, _} ->
        name = if Store.has_stream?(store, key), do: key, else: only
        {:ok, %{"keys" => keys}} = Store.metadata(store, name)
        {key, if(name == key or key =~ ~r/key/, do: Enum.sort(keys), else: {:unread, key})}
      end)

    wanted = fn list -> list |> Enum.map(&to_string/1) |> Enum.sort() end
    verdict(Map.new(case["expect"], fn {key, keys} -> {key, wanted.(keys)} end), got)
  end

  def run("dynamic_read", %{"written" => _}, _case, _root) do
    {:not_applicable, "Elixir's values are immutable: none can refer to itself"}
  end

  # Written with types, and read without. If the case lists more values than messages, all values
  # are written, and the listed messages must have the same values.
  def run("dynamic_read", _params, %{"expect" => %{"values" => values}} = case, root) do
    given = for {_, messages} <- streams(case), m <- messages, do: m.data

    written =
      given ++ Enum.drop([123, 2.718281828459045, true, "x", "Hello", [1, 2, 3]], length(given))

    streams =
      for {v, i} <- Enum.with_index(written),
          do: {"Data#{i}", [%Message{data: v, originating_time: 0}]}

    store = root |> record(streams) |> Store.open!()
    got = for {name, _} <- streams, {:ok, %{data: data}} = Store.at(store, name, 0), do: data
    verdict(values, Enum.take(got, max(length(values), length(given))))
  end

  def run("dynamic_read", _params, case, root) do
    store = root |> record(streams(case)) |> Store.open!()
    [{first, _} | _] = streams(case)

    got =
      Map.new(case["expect"], fn {key, _} ->
        if Store.has_stream?(store, key),
          do: {key, plain(data(store, key))},
          else: {key, plain(hd(data(store, first)))}
      end)

    verdict(case["expect"], got)
  end

  def run("schema_evolution", params, case, root) do
    written = struct_module(params["written_members"], [])
    today = struct_module(params["read_members"], params["required"] || [])
    [members] = values(case, params)
    data = struct(written, for({name, v} <- members, do: {String.to_atom(name), v}))

    path =
      record(root, [{"data", [%Message{data: data, originating_time: 0}]}], fn _ ->
        [type: written]
      end)

    got =
      Pipeline.run(fn p ->
        p
        |> Store.importer(path)
        |> Store.stream("data", type: today)
        |> Situ.each(fn _ -> :ok end)
      end)

    case {got, case["expect_error"]} do
      {{:error, error}, name} when name != nil ->
        if error_fits?(name, error), do: :pass, else: {:fail, {:error, name}, error}

      {{:ok, _}, nil} ->
        [message] = path |> Store.open!() |> Store.messages("data", type: today) |> Enum.to_list()
        value = for {k, v} <- Map.from_struct(message.data), into: %{}, do: {to_string(k), v}
        verdict(case["expect"]["value"], value)

      {other, _} ->
        {:fail, case["expect"] || case["expect_error"], other}
    end
  end

  defp played(path, name) do
    test = self()

    {:ok, report} =
      Pipeline.run(fn p -> p |> Store.importer(path) |> Store.stream(name) |> tell(test) end)

    got = Situ.Conformance.Store.Tape.told()
    {report.start_time, List.last(got).originating_time, length(got)}
  end

  defp point(messages, "first", kind), do: point(hd(messages), kind)
  defp point(messages, "last", kind), do: point(List.last(messages), kind)
  defp point(message, "creation"), do: message.creation_time
  defp point(message, "originating"), do: message.originating_time

  # Written without a pipeline, with the creation times of the case.
  defp written(root, streams) do
    {:ok, writer} = Writer.create("store", root)

    for {name, messages} <- streams do
      {:ok, stream} = Writer.stream(writer, name)
      {:ok, stream} = Writer.append(stream, messages)
      last = List.last(messages)
      if last, do: {:ok, _} = Writer.close_stream(stream, last.originating_time)
    end

    :ok = Writer.close(writer)
    writer.path
  end

  # The statistics of a stream in the case.
  defp figures(info, %{} = wanted),
    do: Map.new(wanted, fn {key, _} -> {key, figure(info, key)} end)

  defp figures(_info, other), do: {:unread, other}

  defp figure(info, "count"), do: info.count
  defp figure(info, "closed"), do: StreamInfo.closed?(info)
  defp figure(info, "type"), do: info.type_name
  defp figure(info, "size"), do: info.size
  defp figure(info, "average_size"), do: StreamInfo.average_size(info)
  defp figure(info, "rate_hz"), do: StreamInfo.message_rate(info)
  defp figure(info, "first_ms"), do: info.first && div(info.first, ms())
  defp figure(info, "last_ms"), do: info.last && div(info.last, ms())
  defp figure(info, "closed_ms"), do: info.closed && div(info.closed, ms())
  defp figure(_info, other), do: raise(ArgumentError, "an unknown figure: #{other}")

  # A struct with these fields, as a program of that time would define it. New fields have
  # defaults, unless they are required.
  defp struct_module(members, required) do
    name = Module.concat(Situ.Conformance.Store, "Struct#{:erlang.phash2({members, required})}")
    fields = for m <- members, do: {String.to_atom(m), default(m)}
    keys = Enum.map(required, &String.to_atom/1)

    if not Code.ensure_loaded?(name) do
      Module.create(
        name,
        quote do
          @enforce_keys unquote(keys)
          defstruct(unquote(Macro.escape(fields)))
        end,
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

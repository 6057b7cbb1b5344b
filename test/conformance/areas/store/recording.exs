defmodule Situ.Conformance.Store.Recording do
  # Stores are written and read, during and after writing.
  import Situ.Conformance.Case, only: [all: 2, error_fits?: 2, meant: 3, verdict: 2]
  import Situ.Conformance.Store.Tape
  alias Situ.{Message, Pipeline, Store}
  alias Situ.Store.Writer

  def run("write_read", params, case, root) do
    streams = streams(case)
    large = params["large_messages"] || []
    path = record(root, streams, fn name -> [large: name in large] end)
    store = Store.open!(path)

    read =
      for {name, _} <- streams, into: %{}, do: {name, Enum.to_list(Store.messages(store, name))}

    # Both ways of reading return the written messages, including creation times.
    same =
      for {name, messages} <- streams do
        envelopes(messages) == envelopes(read[name]) and
          Enum.map(replay(path, name), &%{&1 | source_id: nil}) ==
            Enum.map(read[name], &%{&1 | source_id: nil})
      end

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

        {key, true} when key in ["equal", "same", "identical"] ->
          {key, Enum.all?(same)}

        {key, expected} when is_list(expected) ->
          {key, if(read[key], do: Enum.map(read[key], & &1.data), else: {:unread, key})}

        {key, expected} ->
          {key,
           meant(
             expected,
             ~r/equal|same|identical|unchanged|preserved|written|kept/,
             Enum.all?(same)
           )}
      end)

    if Enum.all?(same), do: verdict(case["expect"], got), else: {:fail, streams, read}
  end

  # The reader starts before the writer, and ends when the writer closes the store.
  def run("live_read", params, case, root) do
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
        fn p -> p |> Store.importer(exporter.path) |> Store.stream(name) |> tell(test) end,
        []
      )

    :ok = Pipeline.launch(writer)
    {:ok, _} = Pipeline.await(writer)
    {:ok, _} = Pipeline.await(reader, 30_000)
    if root == nil, do: Store.delete(exporter.path)
    got = told()

    same? = envelopes(got) == envelopes(messages)

    told =
      Map.new(case["expect"], fn
        {"sum", _} ->
          {"sum", Enum.sum(Enum.map(got, & &1.data))}

        {key, _} when key in ["messages_read", "count"] ->
          {key, length(got)}

        {key, list} when is_list(list) ->
          {key, Enum.map(got, & &1.data)}

        {key, flag} when is_boolean(flag) ->
          {key, if(key =~ ~r/live|while|before/, do: true, else: same?)}

        {key, text} ->
          {key, meant(text, ~r/equal|same|identical|written|every|all/, same?)}
      end)

    if same?, do: all(case, told), else: {:fail, envelopes(messages), envelopes(got)}
  end

  def run("close_at", params, case, root) do
    [{name, messages} | _] = streams(case)
    stop = params["pipeline_stop_ms"] * ms()
    {:ok, writer} = Writer.create("closing", root)
    {:ok, stream} = Writer.stream(writer, name)
    {:ok, stream} = Writer.append(stream, messages)
    {:ok, _} = Writer.close_stream(stream, stop)
    :ok = Writer.close(writer)
    [info] = writer.path |> Store.open!() |> Store.streams()
    last = List.last(replay(writer.path, name))

    verdict(case["expect"], %{
      "closed_time_ms" => div(info.closed, ms()),
      "last_replayed" => %{"t_ms" => div(last.originating_time, ms()), "v" => last.data}
    })
  end

  # Only one writer may use a folder. A second one with the same name gets a separate folder.
  def run("second_writer", _params, case, root) do
    {:ok, first} = Writer.create("twice", root)
    {:ok, second} = Writer.create("twice", root)
    {:ok, fixed} = Writer.create("fixed", root, versioned: false)
    again = Writer.create("fixed", root, versioned: false)
    for writer <- [first, second, fixed], do: Writer.close(writer)

    case {first.path != second.path, again, case} do
      {true, {:error, error}, %{"expect_error" => name}} ->
        if error_fits?(name, error) or name == "already_open",
          do: :pass,
          else: {:fail, {:error, name}, error}

      {apart?, {:error, _}, case} ->
        all(case, %{
          "refused" => true,
          "own_folder" => apart?,
          "third" => meant(case["expect"]["third"], ~r/refused|error/, true)
        })

      other ->
        {:fail, case["expect"] || case["expect_error"], other}
    end
  end

  # Only envelopes were written: times and order, without data.
  def run("write_envelopes", _params, case, root) do
    [{name, messages} | _] = streams(case)
    store = root |> record([{name, messages}], fn _ -> [envelopes: true] end) |> Store.open!()
    got = Enum.to_list(Store.messages(store, name))

    if times(got) == times(messages),
      do: by_stream(%{case | "expect" => Map.delete(case["expect"], name)}, store),
      else: {:fail, times(messages), times(got)}
  end

  # A writer rejects a duplicate stream, and times that do not increase.
  def run("refused", _params, case, root) do
    path = record(root, streams(case))
    {:fail, {:error, case["expect_error"]}, path}
  end

  defp live_streams(%{"message_bytes" => size} = params, _case) do
    data = :binary.copy(<<params["fill"] || 0>>, size)

    messages =
      for i <- 1..params["count"],
          do: %Message{data: data, originating_time: i * ms(), sequence_id: i}

    [{"stream", messages}]
  end

  defp live_streams(_params, case), do: streams(case)

  defp sum_of_element(read, large, n) do
    read
    |> Map.take(large)
    |> Map.values()
    |> List.flatten()
    |> Enum.map(&Enum.at(&1.data, n))
    |> Enum.sum()
  end
end

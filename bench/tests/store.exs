Code.require_file("seek.exs", __DIR__)

defmodule Situ.Bench.Store do
  # A pipeline writes messages to a store, the store is closed, and another pipeline reads it. For
  # large messages, a plain write(2) of the same bytes is measured as well.
  alias Situ.{Delivery, Pipeline, Store}

  defmodule Frame do
    # An image as seen by a store: a small header and raw bytes.
    @behaviour Situ.Codec
    defstruct [:data]
    @impl true
    def codec_name, do: "bench.frame"
    @impl true
    def encode(frame), do: [<<0::64>>, frame.data]
    @impl true
    def decode(<<_::64, data::binary>>), do: {:ok, %__MODULE__{data: data}}
    def decode(_), do: {:error, :short}
  end

  @policies [unlimited: [], throttle: [1], sync: []]

  def tests do
    for {policy, _} <- @policies, {kind, n} <- [int: 400_000, double: 400_000] do
      {"store#{kind}-#{policy}", &small(kind, policy, max(1, round(n * &1)))}
    end ++
      for {policy, _} <- @policies do
        {"store64k-#{policy}", &large("64k", policy, 65_536, max(1, round(8_000 * &1)))}
      end ++
      for {policy, _} <- @policies do
        {"storeframe-#{policy}", &large("frame", policy, 640 * 480 * 3, max(1, round(600 * &1)))}
      end ++
      [
        {"store100b", &hundred(max(1, round(1_000_000 * &1)))},
        {"store-wide", &wide(max(1, round(1_000 * &1)), 500)},
        {"mcap-beside", &beside(max(1, round(1_000_000 * &1)))}
      ]
  end

  defp delivery(:unlimited), do: Delivery.unlimited()
  defp delivery(:throttle), do: Delivery.throttle(1)
  defp delivery(:sync), do: Delivery.synchronous()

  defp in_folder(fun) do
    root = Situ.Bench.folder!()

    try do
      fun.(root)
    after
      File.rm_rf!(root)
    end
  end

  defp settings(policy, interval \\ []),
    do: [pipeline: [default_policy: delivery(policy), replay: [speed: :max] ++ interval]]

  # The policy applies where messages wait for the disk, before the writer.
  defp write(metric, n, unit, root, type, policy, value, every \\ 100) do
    Situ.Bench.measure(metric, n, unit, fn ->
      {:ok, _} =
        Pipeline.run(
          fn p ->
            exporter = Store.create(p, "bench", root)

            p
            |> Situ.from_enumerable(0..(n - 1)//1, every: every)
            |> Situ.map(value, type: type)
            |> Store.write(exporter, "s", type: type, policy: delivery(policy))
          end,
          settings(policy, interval: {0, :unbounded})
        )

      []
    end)
  end

  defp read(metric, n, root, policy, add, opts \\ []) do
    counter = :counters.new(2, [])

    metrics =
      Situ.Bench.measure(metric, n, fn ->
        {:ok, _} =
          Pipeline.run(
            fn p ->
              p
              |> Store.importer(Path.join(root, "bench"), opts)
              |> Store.stream("s")
              |> Situ.each(fn data ->
                :counters.add(counter, 1, 1)
                :counters.add(counter, 2, add.(data))
              end)
            end,
            settings(policy)
          )

        []
      end)

    {metrics, :counters.get(counter, 1), :counters.get(counter, 2)}
  end

  defp bytes(root) do
    root |> Path.join("**") |> Path.wildcard() |> Enum.map(&File.stat!(&1).size) |> Enum.sum()
  end

  defp small(kind, policy, n) do
    in_folder(fn root ->
      {type, value, back} =
        if kind == :int,
          do: {:integer, & &1, & &1},
          else: {:float, &(&1 * 0.5), &trunc(&1 * 2)}

      written = write("store_write_#{kind}_#{policy}", n, "msg/s", root, type, policy, value)
      {read, count, sum} = read("store_read_#{kind}_#{policy}", n, root, policy, back)
      if {count, sum} != {n, div(n * (n - 1), 2)}, do: raise("read #{count} of #{n}, sum #{sum}")
      written ++ read ++ [{"store_bytes_#{kind}_#{policy}", bytes(root) / n, "B/msg"}]
    end)
  end

  # A few different blocks of random bytes in turn, so that no cache holds all of them.
  defp large(name, policy, size, n) do
    payloads = for(_ <- 1..16, do: :crypto.strong_rand_bytes(size)) |> List.to_tuple()
    frame? = name == "frame"

    value = fn i ->
      data = elem(payloads, rem(i, 16))
      if frame?, do: %Frame{data: data}, else: data
    end

    size_of = fn
      %Frame{data: data} -> byte_size(data)
      data -> byte_size(data)
    end

    type = if frame?, do: Frame, else: :binary
    plain = in_folder(fn root -> plain(name, policy, root, payloads, n) end)

    in_folder(fn root ->
      written =
        "store_write_#{name}_#{policy}_MBps"
        |> write(n, "MB/s", root, type, policy, value)
        |> per_byte(size)

      check = fn {metrics, count, sum} ->
        if {count, sum} != {n, n * size}, do: raise("read #{count} of #{n}, #{sum} bytes")
        metrics
      end

      verified = check.(read("store_read_#{name}_#{policy}", n, root, policy, size_of))

      unverified =
        check.(
          read("store_read_#{name}_#{policy}_small", n, root, policy, size_of, verify: :small)
        )

      plain ++ written ++ verified ++ unverified
    end)
  end

  defp plain(name, policy, root, payloads, n) do
    size = byte_size(elem(payloads, 0))

    per_byte(
      Situ.Bench.measure("plain_write_#{name}_#{policy}_MBps", n, "MB/s", fn ->
        {:ok, file} = :file.open(Path.join(root, "plain"), [:write, :raw])
        for i <- 0..(n - 1), do: :ok = :file.write(file, elem(payloads, rem(i, 16)))
        :ok = :file.close(file)
        []
      end),
      size
    )
  end

  defp per_byte([{metric, rate, unit} | rest], size),
    do: [{metric, rate * size / 1.0e6, unit} | rest]

  # Messages of 100 bytes and of 1 MB, with Situ's writer and reader without a pipeline, and with
  # the `mcap` crate in a separate program (`native/situ_mcap/examples/peer.rs`), alternating
  # within one run.
  defp beside(n) do
    in_folder(fn root ->
      for {name, size, n} <- [{"100b", 100, n}, {"1mb", 1_000_000, max(1, div(n, 5_000))}],
          metric <- ours(name, root, size, n) ++ peer(name, root, size, n),
          do: metric
    end)
  end

  defp ours(name, root, size, n) do
    rest = :crypto.strong_rand_bytes(size - 8)

    # The crate's program writes the same payload repeatedly, from the processor's cache, and so
    # does Situ for 1 MB.
    large? = size > 32_768
    payloads = for i <- 0..1, do: <<i::64, rest::binary>>
    data = fn i -> if large?, do: Enum.at(payloads, rem(i, 2)), else: <<i::64, rest::binary>> end

    messages =
      for i <- 0..(min(n, 100_000) - 1),
          do: %Situ.Message{
            data: data.(i),
            originating_time: i * 1_000,
            creation_time: i * 1_000 + 5,
            sequence_id: i + 1
          }

    batches = Enum.chunk_every(messages, if(large?, do: 1, else: 512))
    n = length(messages)
    {:ok, writer} = Store.Writer.create(name, root)
    {:ok, stream} = Store.Writer.stream(writer, "s", type: :binary)

    written =
      Situ.Bench.measure("situ_write_#{name}", n, fn ->
        Enum.reduce(batches, stream, fn batch, stream ->
          {:ok, stream} = Store.Writer.append(stream, batch)
          stream
        end)

        :ok = Store.Writer.close(writer)
        []
      end)

    store = Store.open!(writer.path)
    sum = :counters.new(1, [])

    # Runs in a separate process, so that the garbage collector does not scan the messages that
    # were written.
    reader = fn ->
      for %{data: <<i::64, _::binary>>} <- Store.messages(store, "s"),
          do: :counters.add(sum, 1, i)

      []
    end

    read =
      Situ.Bench.measure("situ_read_#{name}", n, fn ->
        reader |> Task.async() |> Task.await(:infinity)
      end)

    if :counters.get(sum, 1) != if(large?, do: div(n, 2), else: div(n * (n - 1), 2)),
      do: raise("not all of #{n} messages were read")

    written ++ read
  end

  defp peer(name, root, size, n) do
    file = Path.join(root, "#{name}.mcap")
    {text, 0} = System.cmd(peer_program(), [file, "#{n}", "#{size}"])

    for line <- String.split(text, "\n", trim: true),
        [what, cpu, rate] = String.split(line),
        metric <- [
          {"mcap_#{what}_#{name}", elem(Float.parse(rate), 0), "msg/s"},
          {"mcap_#{what}_#{name}_cpu", elem(Float.parse(cpu), 0) / 1_000, "us/msg"}
        ],
        do: metric
  end

  defp peer_program do
    native = Path.expand("../../native", __DIR__)
    args = ~w(build --release --locked --quiet -p situ_mcap --example peer)
    {_, 0} = System.cmd("cargo", args, cd: native, into: IO.stream(:stderr, :line))
    Path.join(native, "target/release/examples/peer")
  end

  # Many streams in one store, with few messages each: includes the start and the end of the pipelines. The test's peak
  # memory is that of the whole VM.
  defp wide(streams, each) do
    in_folder(fn root ->
      n = streams * each
      names = for i <- 1..streams, do: "s#{i}"

      written =
        Situ.Bench.measure("store_wide_write", n, fn ->
          {:ok, _} =
            Pipeline.run(
              &write_wide(&1, root, names, each),
              settings(:unlimited, interval: {0, :unbounded})
            )

          []
        end)

      counter = :counters.new(2, [:write_concurrency])

      read =
        Situ.Bench.measure("store_wide_read", n, fn ->
          {:ok, _} = Pipeline.run(&read_wide(&1, root, names, counter), settings(:unlimited))
          []
        end)

      {count, sum} = {:counters.get(counter, 1), :counters.get(counter, 2)}
      expected = streams * div(each * (each - 1), 2)
      if {count, sum} != {n, expected}, do: raise("read #{count} of #{n}, sum #{sum}")
      written ++ read ++ [{"store_wide_bytes", bytes(root) / n, "B/msg"}]
    end)
  end

  defp write_wide(p, root, names, each) do
    exporter = Store.create(p, "bench", root)

    for name <- names do
      p
      |> Situ.from_enumerable(0..(each - 1)//1, every: 100_000)
      |> Situ.map(& &1, type: :integer)
      |> Store.write(exporter, name, type: :integer)
    end
  end

  defp read_wide(p, root, names, counter) do
    importer = Store.importer(p, Path.join(root, "bench"))

    for name <- names do
      importer
      |> Store.stream(name)
      |> Situ.each(fn number ->
        :counters.add(counter, 1, 1)
        :counters.add(counter, 2, number)
      end)
    end
  end

  defp hundred(n) do
    in_folder(fn root ->
      # A number and eight sines of a sensor, created in advance: eight sines take 1 us, more than
      # writing them.
      sines =
        for i <- 0..999, into: <<>> do
          for k <- 1..8, into: <<>>, do: <<:math.sin(i * k * 1.0e-3)::float>>
        end

      value = fn i -> <<i::64, binary_part(sines, rem(i, 1_000) * 64, 64)::binary, 0::224>> end

      number = fn <<i::64, _::binary>> -> i end
      written = write("store100b_write", n, "msg/s", root, :binary, :unlimited, value, 1_000)
      {read, count, sum} = read("store100b_read", n, root, :unlimited, number)
      if {count, sum} != {n, div(n * (n - 1), 2)}, do: raise("read #{count} of #{n}, sum #{sum}")
      written ++ read ++ Situ.Bench.StoreSeek.seek("store100b", root, n, number, 1_000)
    end)
  end
end

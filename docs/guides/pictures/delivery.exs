# Measures what each delivery policy does with a camera five times as fast as its consumer, and draws it:
#
#     mix run docs/guides/pictures/delivery.exs          (in apps/situ; writes delivery.svg to the folder of this file)
defmodule Pictures.Camera do
  # Emits five messages every 10 ms, even if its consumer is slower: a push source cannot wait.
  use Situ.Component, outputs: [out: :any]

  @impl true
  def handle_start(context, state),
    do: {[{:complete, :infinity}, next(context.start_time)], state}

  @impl true
  def handle_info({:timer, due}, _context, state),
    do: {for(i <- 0..4, do: {:out, due + i * 2_000_000, i}) ++ [next(due)], state}

  defp next(time), do: {:timer, time + 10_000_000, time + 10_000_000}
end

defmodule Pictures.Delivery do
  alias Situ.{Delivery, Pipeline, Time}

  @seconds 3
  defp policies,
    do: [
      {"unlimited()", Delivery.unlimited()},
      {"throttle()", Delivery.throttle()},
      {"latest()", Delivery.latest()},
      {"max_queue(50)", Delivery.max_queue(50)},
      {"max_latency(ms(200))", Delivery.max_latency(Time.ms(200))},
      {"latest(guarantee: one in ten)", Delivery.latest(guarantee: &(&1 == :keep))}
    ]

  def draw(file) do
    runs = for {name, policy} <- policies(), do: {name, measure(policy)}
    File.write!(file, svg(runs))
    for {name, run} <- runs, do: IO.puts("#{name}: #{summary(run)}")
  end

  def summary(run) do
    last = List.last(run.samples)
    ages = run.samples |> Enum.map(& &1.age) |> Enum.sort()

    "processed #{run.processed}, dropped #{run.dropped}, queue at the end #{last.queue}, " <>
      "median age #{round(Enum.at(ages, div(length(ages), 2)))} ms"
  end

  defp measure(policy) do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Pictures.Camera)
          |> Situ.map(fn i -> if i == 0 and :rand.uniform(2) == 1, do: :keep, else: i end)
          |> Situ.each(fn _ -> Process.sleep(9) end, policy: policy, name: "Consumer")
        end,
        pipeline: [stop_timeout: 60_000]
      )

    begun = System.monotonic_time(:millisecond)
    samples = sample(p, begun, [])
    edge = edge(p)
    # Does not call stop/1, which would wait for every message that was sent under unlimited().
    Process.exit(p, :kill)
    %{samples: samples, processed: edge.processed, dropped: edge.dropped}
  end

  defp sample(p, begun, samples) do
    Process.sleep(25)
    at = System.monotonic_time(:millisecond) - begun
    edge = edge(p)
    samples = [%{at: at, queue: edge.queue, age: edge.latency_last / 1.0e6} | samples]
    if at < @seconds * 1_000, do: sample(p, begun, samples), else: Enum.reverse(samples)
  end

  # Returns the edge into the consumer, with the messages of all queues added up.
  defp edge(p) do
    edges = Pipeline.info(p).edges
    %{List.last(edges) | queue: edges |> Enum.map(& &1.queue) |> Enum.sum()}
  end

  # Draws two panels per policy: the number of waiting messages, and the age of processed messages.

  @width 360
  @height 84
  @row 118

  defp svg(runs) do
    queue = most(runs, :queue)
    age = most(runs, :age)
    rows = runs |> Enum.with_index() |> Enum.map_join("\n", &row(&1, queue, age))

    """
    <svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 820 #{length(runs) * @row + 46}" font-family="sans-serif" font-size="12">
    <rect width="100%" height="100%" fill="white"/>
    <text x="30" y="20" font-weight="bold">messages waiting</text>
    <text x="430" y="20" font-weight="bold">age of the processed message, ms</text>
    #{rows}
    </svg>
    """
  end

  defp most(runs, key),
    do: for({_, run} <- runs, sample <- run.samples, do: sample[key]) |> Enum.max() |> max(1)

  defp row({{name, run}, index}, queue, age) do
    top = 34 + index * @row

    """
    <text x="30" y="#{top + 12}" fill="#444">#{name}: #{summary(run)}</text>
    #{panel(30, top + 18, run.samples, :queue, queue, "#0b6e99")}
    #{panel(430, top + 18, run.samples, :age, age, "#b3541e")}
    """
  end

  defp panel(x, y, samples, key, most, colour) do
    points =
      Enum.map_join(samples, " ", fn s ->
        "#{x + round(s.at / (@seconds * 1_000) * @width)},#{y + @height - scaled(s[key], most)}"
      end)

    highest = samples |> Enum.map(& &1[key]) |> Enum.max()

    """
    <rect x="#{x}" y="#{y}" width="#{@width}" height="#{@height}" fill="none" stroke="#ccc"/>
    <polyline points="#{points}" fill="none" stroke="#{colour}" stroke-width="1.5"/>
    <text x="#{x + @width - 4}" y="#{y + 12}" text-anchor="end" fill="#888">max #{round(highest)}</text>
    """
  end

  # A square-root scale shows both small and large values.
  defp scaled(value, most), do: round(:math.sqrt(max(value, 0) / most) * (@height - 6))
end

Logger.configure(level: :none)
Pictures.Delivery.draw(Path.join(__DIR__, "delivery.svg"))

# Broadway uploads the visitors that a pipeline has counted, in batches of ten, and the server refuses some of them. A
# Flow is the source of another stream of the pipeline. Run it with: mix run examples/uploads.exs

defmodule Uploads do
  use Broadway

  @impl true
  def handle_message(_processor, message, _context), do: message

  @impl true
  def handle_batch(:default, messages, _info, _context) do
    times = Enum.map(messages, & &1.metadata.situ.originating_time)
    seconds = Situ.Time.to_seconds(Enum.max(times) - Enum.min(times))
    IO.puts("uploads #{length(messages)} visitors, who came within #{Float.round(seconds, 2)} s")

    Enum.map(
      messages,
      &if(rem(&1.data, 40) == 0, do: Broadway.Message.failed(&1, "full"), else: &1)
    )
  end
end

{:ok, pipeline} =
  Situ.Pipeline.start(
    fn p ->
      p
      |> Situ.sequence(1, &(&1 + 1), every: Situ.Time.ms(20))
      |> Situ.GenStage.dispatch(:demand, name: "Visitors")

      p
      |> Situ.GenStage.from([], name: "Squares")
      |> Situ.each(&IO.puts("the flow has sent #{&1}"))
    end,
    pipeline: [name: "Door"]
  )

{:ok, _} =
  Broadway.start_link(Uploads,
    name: Uploads,
    producer: [
      module:
        {Situ.Broadway.Producer,
         pipeline: "Door",
         stream: "Visitors",
         acknowledge: fn _successful, failed ->
           for message <- failed, do: IO.puts("visitor #{message.data} was refused")
         end}
    ],
    processors: [default: [concurrency: 2, max_demand: 5]],
    batchers: [default: [batch_size: 10, batch_timeout: 500]]
  )

{:ok, _} =
  1..3
  |> Flow.from_enumerable(stages: 1)
  |> Flow.map(&(&1 * &1))
  |> Situ.Broadway.connect_flow(pipeline, "Squares")

Process.sleep(2_000)
Broadway.stop(Uploads)
{:ok, report} = Situ.Pipeline.stop(pipeline)
IO.puts("errors: #{length(report.errors)}")

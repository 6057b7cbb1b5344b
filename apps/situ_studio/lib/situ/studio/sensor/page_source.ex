defmodule Situ.Studio.Sensor.PageSource do
  @moduledoc false
  # The component of sensors that are pages: emits the values that the page sends. The sensor's module parses them
  # (`Situ.Studio.Sensor.Packet`) and determines the outputs.
  use Situ.Component,
    options: [
      sensor: [type: :atom, required: true, doc: "The sensor's module."],
      page: [type: :string, required: true, doc: "The page's name."],
      buffer: [type: :pos_integer, default: 200, doc: "The number of buffered values per output."],
      credited: [type: :atom, required: true, doc: "The output that the page sends on credit."],
      ahead: [type: :pos_integer, required: true, doc: "The maximum number of credits in flight."],
      end_with_page: [
        type: :boolean,
        default: false,
        doc: "Whether the outputs end with the page."
      ]
    ]

  alias Situ.Studio.Sensor.Inbox

  @impl true
  def init(opts),
    do:
      {:ok,
       Inbox.new(
         opts[:sensor],
         opts[:page],
         Keyword.take(opts, [:credited, :ahead, :buffer, :end_with_page])
       )}

  @impl true
  def handle_start(_context, inbox), do: Inbox.register_sensor(inbox)

  @impl true
  def handle_info(message, _context, inbox),
    do: inbox |> Inbox.handle_message(message) |> Inbox.complete_outputs()

  @impl true
  def handle_demand(n, _context, inbox) do
    {actions, inbox} = Inbox.take_actions(inbox, n)
    {completion, inbox} = Inbox.complete_outputs(inbox)
    {actions ++ completion, inbox}
  end

  @impl true
  def handle_stop(_final_time, _context, inbox), do: {[], inbox}

  @impl true
  def terminate(_reason, inbox), do: Inbox.notify_ended(inbox)

  @impl true
  def describe(inbox), do: Inbox.describe(inbox)
end

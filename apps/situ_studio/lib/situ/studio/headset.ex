defmodule Situ.Studio.Headset do
  @schema [
    page: [
      type: :string,
      default: "headset",
      doc: "The page's name: its address is `/headset?name=NAME` of the studio."
    ],
    buffer: [
      type: :pos_integer,
      default: 200,
      doc:
        "Hands, rays and planes of so many moments may wait for a slow pipeline; then the oldest are dropped."
    ]
  ]

  @moduledoc """
  A headset as a source: a page of the studio, opened in the headset's own browser (WebXR).

      headset = Situ.Studio.Headset.open(p, page: "headset")
      headset.head |> Situ.map(&Situ.Ray3.from_pose/1) |> Situ.Studio.Headset.Display.show(as: "ahead")

  The user opens `/headset?name=headset` in the studio and presses Enter. Browsers give headsets only to pages over TLS
  (`Situ.Studio`, `tls: :own`), or of the machine itself.

  | output | gives |
  |---|---|
  | `:head` | where the head is and looks, `Situ.Pose` |
  | `:left`, `:right` | a hand that is seen: `Situ.Skeleton` of 26 joints, its `id` is `:left` or `:right` |
  | `:gaze` | where the eyes look, `Situ.Ray3`, of headsets that tell it |
  | `:select` | `%{left: boolean, right: boolean}`, which hand pinches (or which trigger is pulled), when it changes |
  | `:planes` | floors, walls and tables, `Situ.Studio.Headset.Packet.plane/0`, when they change |
  | `:clock` | how far the browser's clock is ahead, ms, each time it is measured |

  Axes are x forward, y left, z up, in metres; the origin is on the floor, where the session began. A head's pose has
  its x axis along the view. Joints are those of WebXR, and `:palm` between the ends of the middle finger's metacarpal;
  a joint's x axis points along its bone, towards the tip.

  Times are the browser's, corrected by the difference of the clocks, which is measured by short round trips. A
  pipeline that has not taken the last moments holds the page back: it sends the next head's pose, and all that belongs
  to it, when there is room, and drops the moments between.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    outputs: [
      head: Situ.Pose,
      left: Situ.Skeleton,
      right: Situ.Skeleton,
      gaze: Situ.Ray3,
      select: :map,
      planes: {:list, :map},
      clock: :float
    ],
    options: @schema

  alias Situ.Studio.Headset.Packet
  alias Situ.Studio.Sensor.Inbox

  @behaviour Situ.Studio.Sensor.Packet
  # Moments that may be under way.
  @ahead 4

  @doc "Adds the headset to a pipeline; returns its streams."
  @spec open(Situ.Pipeline.t(), keyword()) :: %{
          head: Situ.Stream.t(),
          left: Situ.Stream.t(),
          right: Situ.Stream.t(),
          gaze: Situ.Stream.t(),
          select: Situ.Stream.t(),
          planes: Situ.Stream.t(),
          clock: Situ.Stream.t()
        }
  def open(p, opts \\ []), do: Situ.source(p, __MODULE__, opts)

  @impl Situ.Component
  def init(opts),
    do:
      {:ok,
       Inbox.new(__MODULE__, opts[:page], credited: :head, ahead: @ahead, buffer: opts[:buffer])}

  @impl Situ.Component
  def handle_start(_context, inbox), do: Inbox.start(inbox)

  @impl Situ.Component
  def handle_info(message, _context, inbox), do: {[], Inbox.info(inbox, message)}

  @impl Situ.Component
  def handle_demand(n, _context, inbox), do: Inbox.take(inbox, n)

  @impl Situ.Component
  def handle_stop(_final_time, _context, inbox), do: {[], inbox}

  @impl Situ.Component
  def terminate(_reason, inbox), do: Inbox.ended(inbox)

  @impl Situ.Component
  def describe(inbox), do: Inbox.describe(inbox)

  @doc false
  @impl Situ.Studio.Sensor.Packet
  defdelegate parse(bytes), to: Packet
end

defmodule Situ.Studio.Headset do
  @moduledoc """
  Reads a headset through a page of the studio, opened in the headset's own browser (WebXR).

      headset = Situ.Studio.Headset.open(p, page: "headset")
      headset.head |> Situ.map(&Situ.Ray3.from_pose/1) |> Situ.Studio.Headset.Display.show(as: "ahead")

  The user opens `/headset?name=headset` in the studio and presses Enter. Browsers expose WebXR only to pages served
  over TLS (`Situ.Studio`, `tls: :own`) or from localhost.

  | output | value |
  |---|---|
  | `:head` | the head's pose, `Situ.Pose` |
  | `:left`, `:right` | a tracked hand: `Situ.Skeleton` of 26 joints with the `id` `:left` or `:right` |
  | `:gaze` | the gaze direction, `Situ.Ray3`, if the headset reports it |
  | `:select` | `%{left: boolean, right: boolean}`, which hand pinches (or which trigger is pulled), on every change |
  | `:planes` | floors, walls and tables, on every change: maps with a `label`, a `polygon` of points and the `Situ.Rectangle3` around it |
  | `:clock` | the offset of the browser's clock in ms, after every measurement |

  Axes are x forward, y left, z up, in meters; the origin is on the floor, where the session started. The x axis of
  the head's pose is the view direction. Joints are the joints of WebXR and `:palm`, in the middle of the middle
  finger's metacarpal. A joint's x axis points along its bone, toward the tip.

  Times are from the browser, corrected by the clock offset, which is measured with short round trips. A slow pipeline
  slows the page down: the page sends the next sample (the head pose and everything that belongs to it) only when the
  pipeline has capacity, and drops the samples in between.
  """

  @schema [
    page: [
      type: :string,
      default: "headset",
      doc: "The page's name; its address in the studio is `/headset?name=NAME`."
    ],
    buffer: [
      type: :pos_integer,
      default: 200,
      doc:
        "The number of samples whose hands, rays and planes are buffered for a slow pipeline; the oldest are dropped."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  alias Situ.Studio.Headset.Packet
  alias Situ.Studio.Sensor.PageSource

  @behaviour Situ.Studio.Sensor.Packet
  @outputs [
    head: Situ.Pose,
    left: Situ.Skeleton,
    right: Situ.Skeleton,
    gaze: Situ.Ray3,
    select: :map,
    planes: {:list, :map},
    clock: :float
  ]

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
  def open(p, opts \\ []) do
    fixed = [sensor: __MODULE__, credited: :head, ahead: 4]
    placement = [default_name: "Headset", outputs: @outputs]
    Situ.source(p, PageSource, fixed ++ placement ++ Keyword.put_new(opts, :page, "headset"))
  end

  @doc false
  @impl true
  defdelegate parse(bytes), to: Packet
end

defmodule Situ.Media.Capture do
  @moduledoc false
  # The shared implementation of camera, microphone and network stream: a running capture with its
  # clock and reconnects. It is pure except that it starts and stops the reader.
  #
  # A device cannot wait, so up to `:buffer` frames wait for the pipeline, and the oldest is dropped and counted beyond
  # that. A capture runs in its own process (`async: true`), so that a slow operator does not keep it from dropping
  # frames. When a sender's clock jumps (the sender was restarted, or switched to another file), it is synchronized with
  # the pipeline's clock again. Each stream of a sender has its own stall watch.
  #
  # `use Situ.Media.Capture`, after `use Situ.Component`, defines all callbacks except `init/1`
  # for a component whose state is a capture.
  alias Situ.{AudioBuffer, AudioFormat, AudioOps}
  alias Situ.Component.Context
  alias Situ.Media.Capture.{Arguments, Clock, StallWatch}
  alias Situ.Media.{Decoder, Device}
  alias Situ.Media.FFmpeg.Reader
  require Logger

  @retry 1_000_000_000
  @credits 4
  # A simulated device begins this many ns after the pipeline, so that ffmpeg is running and frames are on time.
  @lead 500_000_000
  # Clocks that differ by less than this (ns) are considered the same clock.
  @same_clock 1_000_000

  @enforce_keys [:driver, :address, :outputs, :opts]
  defstruct [
    :driver,
    :address,
    :outputs,
    :opts,
    :clock,
    :times,
    :reader,
    :streams,
    :watch,
    :lost,
    queue: :queue.new(),
    size: 0,
    dropped: 0,
    last: %{},
    jumps: 0,
    silent: [],
    ended: false
  ]

  @type t :: %__MODULE__{}
  @type result :: {[Situ.Component.action()], t()}

  # Camera, microphone and network stream differ only in options, outputs and `init/1`. The macro
  # contains nothing but calls. One component for all three would give them the same options and
  # names.
  @doc false
  defmacro __using__(_opts) do
    quote do
      alias Situ.Media.Capture

      @impl Situ.Component
      def handle_start(context, capture), do: Capture.start_reader(capture, context)
      @impl Situ.Component
      def handle_demand(n, context, capture), do: Capture.handle_demand(capture, n, context)
      @impl Situ.Component
      def handle_info(info, context, capture), do: Capture.handle_info(capture, info, context)
      @impl Situ.Component
      def handle_stop(_final_time, _context, capture), do: {[], Capture.stop_reader(capture)}
      @impl Situ.Component
      def terminate(_reason, capture), do: Capture.stop_reader(capture)
      @impl Situ.Component
      def describe(capture), do: Capture.describe_status(capture)
    end
  end

  @doc """
  Builds a capture of `device` that is not running yet. `outputs` maps `:video` and `:audio` to outputs of the
  component. `opts` must have `:format`, `:size`, `:rate`, `:audio_format`, `:audio_buffer`, `:buffer`, `:reconnect` and
  `:stall_timeout`, and may have `:gain`.
  """
  @spec new(Device.device(), %{atom() => atom()}, keyword()) ::
          {:ok, t()} | {:error, Situ.Error.t()}
  def new(device, outputs, opts) do
    with {:ok, {driver, address}} <- Device.parse_name(device) do
      {:ok, %__MODULE__{driver: driver, address: address, outputs: outputs, opts: opts}}
    end
  end

  @doc "Starts capturing. Raises `Situ.Error` if the device cannot be passed to `ffmpeg`."
  @spec start_reader(t(), Context.t()) :: result()
  def start_reader(%__MODULE__{} = capture, context) do
    kind = if Map.has_key?(capture.outputs, :video), do: :camera, else: :microphone
    # Read this first, because `context.now` becomes outdated during the calls below.
    ahead = context.now - Situ.Time.now()

    with {:ok, %{args: args, clock: clock} = source} <-
           capture.driver.capture(capture.address, kind, capture.opts),
         {:ok, reader} <- Reader.start_link(reader_options(capture, args, clock)) do
      Reader.request_frames(reader, @credits)
      capture = set_reconnect(%{capture | reader: reader, clock: clock, streams: nil}, source)
      # A capture that reconnects forever has no end; all others announce their end.
      endless = if capture.opts[:reconnect], do: [{:complete, :infinity}], else: []
      {endless, %{capture | times: Clock.new(clock_offset(clock, context, ahead, capture.last))}}
    else
      {:error, error} -> raise error
    end
  end

  # By default every source is reopened, unless it has an end.
  defp set_reconnect(capture, source) do
    opts =
      Keyword.update(capture.opts, :reconnect, nil, &if(&1 == nil, do: !source[:ends?], else: &1))

    %{capture | opts: opts}
  end

  @doc "Handles a message to the component: frames and ends from the reader, or a timer."
  @spec handle_info(t(), term(), Context.t()) :: result()
  def handle_info(%__MODULE__{reader: reader} = capture, {Reader, reader, result}, context),
    do: handle_result(result, capture, context)

  def handle_info(%__MODULE__{reader: reader} = capture, {:timer, {:due, reader, _}}, _context) do
    Reader.request_frames(reader, 1)
    {[], capture}
  end

  def handle_info(%__MODULE__{reader: reader} = capture, {:timer, {:watch, reader}}, context)
      when is_pid(reader),
      do: check_streams(capture, context)

  def handle_info(%__MODULE__{reader: nil} = capture, {:timer, :reconnect}, context) do
    {_, capture} = start_reader(capture, context)
    {[], capture}
  end

  def handle_info(%__MODULE__{reader: reader} = capture, {:EXIT, reader, reason}, context) do
    error =
      Situ.Error.new(:device_lost, "#{capture.address}: the reader ended: #{inspect(reason)}")

    handle_result({:error, error}, capture, context)
  end

  def handle_info(capture, _other, _context), do: {[], capture}

  @doc "Emits up to `n` frames that have arrived and are due."
  @spec handle_demand(t(), pos_integer(), Context.t()) :: result()
  def handle_demand(%__MODULE__{} = capture, n, context),
    do: take_due_frames(capture, n, due_time(capture, context), [])

  @doc "Stops the capture immediately."
  @spec stop_reader(t()) :: t()
  def stop_reader(%__MODULE__{reader: nil} = capture), do: capture

  def stop_reader(%__MODULE__{reader: reader} = capture) do
    Reader.stop_ffmpeg(reader)
    %{capture | reader: nil}
  end

  @doc "Describes the capture in one line for people."
  @spec describe_status(t()) :: String.t()
  def describe_status(%__MODULE__{} = capture) do
    state = if capture.reader, do: "running", else: "not connected"

    jumps =
      case capture.jumps do
        0 -> ""
        1 -> ", its clock jumped once"
        n -> ", its clock jumped #{n} times"
      end

    silent = if capture.silent != [], do: ", no #{Enum.join(capture.silent, " or ")}", else: ""
    "#{capture.address}: #{state}, #{capture.dropped} dropped#{jumps}#{silent}"
  end

  defp reader_options(%{opts: opts, outputs: outputs} = capture, args, clock) do
    zero = if clock == :start, do: ["-start_at_zero"], else: []

    [
      args:
        ["-copyts" | zero] ++
          ~w(-thread_type slice) ++
          args ++
          Arguments.build_output_args(outputs, clock, opts),
      name: capture.address,
      stall_timeout: opts[:stall_timeout] |> div(1_000_000)
    ]
  end

  # Returns the offset to add to the capture's times, or `nil` if the first frame sets it.
  defp clock_offset(:start, context, _ahead, last) when last == %{},
    do: context.start_time + @lead

  defp clock_offset(:start, context, _ahead, _again), do: context.now + @lead
  defp clock_offset(:arrival, _context, _ahead, _last), do: nil

  defp clock_offset(:wall, _context, ahead, _last),
    do: if(abs(ahead) < @same_clock, do: 0, else: ahead)

  defp handle_result({:streams, streams}, capture, context) do
    if capture.lost, do: Logger.info("#{capture.address} is back")
    kinds = for {_, %{class: kind}} <- streams, is_map_key(capture.outputs, kind), do: kind
    watch = StallWatch.new(kinds, capture.opts[:stall_timeout], context.now)
    capture = %{capture | streams: streams, lost: nil, watch: watch, silent: []}
    {schedule_watch(capture, context), capture}
  end

  defp handle_result({:frame, frame}, capture, context) do
    stream = Map.fetch!(capture.streams, frame.stream)

    {kind, time, data} =
      Decoder.convert_frame(
        frame,
        stream,
        capture.opts[:format],
        audio_format(stream, capture.opts)
      )

    case Clock.place_frame(capture.times, kind, time, context.now) do
      {:ok, time, times} ->
        capture = note_frame(%{capture | times: times}, kind, time, context)
        accept_frame(capture, kind, time, apply_gain(data, capture.opts[:gain]), context)

      {:wait, times} ->
        Reader.request_frames(capture.reader, 1)
        {[], note_frame(%{capture | times: times}, kind, nil, context)}

      {:jump, by, times} ->
        Reader.request_frames(capture.reader, 1)
        capture = note_frame(%{capture | times: times}, kind, nil, context)
        {[], report_jump(capture, kind, by)}
    end
  end

  defp handle_result(:eof, %{opts: opts} = capture, context) do
    if opts[:reconnect],
      do: schedule_reconnect(capture, "ended", context),
      else: finish_capture(capture)
  end

  defp handle_result({:error, error}, %{streams: nil, lost: nil} = capture, _context) do
    kind = if Map.has_key?(capture.outputs, :video), do: :camera, else: :microphone
    raise Device.open_error(error, capture.driver, capture.address, kind)
  end

  defp handle_result({:error, error}, %{opts: opts} = capture, context) do
    if opts[:reconnect],
      do: schedule_reconnect(capture, Exception.message(error), context),
      else: raise(error)
  end

  defp schedule_reconnect(capture, why, context) do
    unless capture.lost,
      do: Logger.warning("#{capture.address} is lost, trying again every second: #{why}")

    {[{:timer, :reconnect, context.now + @retry}], %{stop_reader(capture) | lost: why}}
  end

  defp apply_gain(%AudioBuffer{} = buffer, gain) when gain not in [nil, 1, 1.0],
    do: AudioOps.gain!(buffer, gain)

  defp apply_gain(data, _gain), do: data

  # Emits the waiting frames first; see take_due_frames/4.
  defp finish_capture(%{size: 0} = capture), do: report_end(stop_reader(capture))
  defp finish_capture(capture), do: {[], %{stop_reader(capture) | ended: true}}

  defp report_end(capture) do
    times = Map.values(capture.last)
    {[{:complete, Enum.max(times, fn -> 0 end)}], %{capture | ended: false}}
  end

  defp note_frame(capture, kind, time, %{now: now}),
    do: %{capture | watch: StallWatch.note_frame(capture.watch, kind, time, now)}

  defp report_jump(capture, kind, by) do
    Logger.warning(
      "#{capture.address}: the sender's clock jumped by #{Situ.Time.format_duration(by)} (#{kind}), " <>
        "as when it restarts; later frames are stamped from the time of arrival"
    )

    %{capture | jumps: capture.jumps + 1}
  end

  # A stream that stops while the other one flows is only reported: reopening the device would interrupt the other
  # one. When frames keep coming with the same time, ffmpeg has lost the sender's clock, and the device is reopened.
  defp check_streams(%{opts: opts} = capture, context) do
    %{silent: silent, stuck: stuck} = StallWatch.find_stalls(capture.watch, context.now)

    if stuck != [] and opts[:reconnect] do
      schedule_reconnect(
        capture,
        "the times of its #{Enum.join(stuck, " and ")} do not move",
        context
      )
    else
      report_silence(silent -- capture.silent, capture)
      {schedule_watch(capture, context), %{capture | silent: silent}}
    end
  end

  defp report_silence([], _capture), do: :ok

  defp report_silence(kinds, %{opts: opts} = capture) do
    timeout = Situ.Time.format_duration(opts[:stall_timeout])
    Logger.warning("#{capture.address}: no #{Enum.join(kinds, " and no ")} for #{timeout}")
  end

  # Only the streams of a sender can stop independently of each other.
  defp schedule_watch(%{clock: :arrival, opts: opts} = capture, context) do
    period = min(div(opts[:stall_timeout], 4), 1_000_000_000)
    [{:timer, {:watch, capture.reader}, context.now + max(period, 1_000_000)}]
  end

  defp schedule_watch(_capture, _context), do: []

  # A frame of a simulated device can be early. It waits until it is due, and no further frame is requested until then.
  defp accept_frame(%{clock: :start} = capture, kind, time, data, %{now: now}) when time > now do
    {[{:timer, {:due, capture.reader, {kind, time}}, time}],
     queue_frame(capture, kind, time, data)}
  end

  defp accept_frame(capture, kind, time, data, _context) do
    Reader.request_frames(capture.reader, 1)
    {[], queue_frame(capture, kind, time, data)}
  end

  defp due_time(%{clock: :start}, %{now: now}), do: now
  defp due_time(_capture, _context), do: :any

  defp audio_format(%{class: :audio} = stream, opts) do
    opts[:audio_format] ||
      %AudioFormat{rate: stream.rate, channels: stream.channels, sample: :s16}
  end

  defp audio_format(_stream, _opts), do: nil

  defp queue_frame(capture, kind, time, data) do
    case capture.last do
      %{^kind => last} when time <= last ->
        %{capture | dropped: capture.dropped + 1}

      last ->
        queue = :queue.in({Map.fetch!(capture.outputs, kind), time, data}, capture.queue)

        capture = %{
          capture
          | queue: queue,
            size: capture.size + 1,
            last: Map.put(last, kind, time)
        }

        limit_queue(capture)
    end
  end

  defp limit_queue(%{size: size, opts: opts} = capture) do
    if size > max(opts[:buffer], @credits) do
      {_, queue} = :queue.out(capture.queue)
      %{capture | queue: queue, size: size - 1, dropped: capture.dropped + 1}
    else
      capture
    end
  end

  defp take_due_frames(%{size: 0, ended: true} = capture, _n, _due, actions) do
    {last, capture} = report_end(capture)
    {Enum.reverse(actions) ++ last, capture}
  end

  defp take_due_frames(%{size: size} = capture, n, _due, actions) when n == 0 or size == 0,
    do: {Enum.reverse(actions), capture}

  defp take_due_frames(capture, n, due, actions) do
    case :queue.out(capture.queue) do
      # In Erlang's term order every number is smaller than the atom `:any`.
      {{:value, {_output, time, _data} = item}, queue} when time <= due ->
        take_due_frames(%{capture | queue: queue, size: capture.size - 1}, n - 1, due, [
          item | actions
        ])

      _ ->
        {Enum.reverse(actions), capture}
    end
  end
end

defmodule Situ.Studio.Web.StartPanel do
  @moduledoc false
  # The four ways to a first recording, on the start page: add a file, make the sample, record with this browser's
  # camera, connect to another machine. Ways that are not allowed here are not offered.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Live.Socket
  alias Situ.Studio.{CameraRecording, Catalog, SampleRecording}
  alias Situ.Studio.Web.Paths

  @doc "Returns the assigns of the panel; a view-only page has no panel."
  @spec initial_assigns(studio :: String.t(), viewer? :: boolean()) :: keyword()
  def initial_assigns(_studio, true), do: [start: nil]

  def initial_assigns(studio, false) do
    folder = with {:ok, folder} <- Catalog.writable_folder(studio), do: folder, else: (_ -> nil)
    sample = if folder, do: List.first(SampleRecording.list_samples())
    [start: %{folder: folder, sample: sample, progress: nil, connecting: false, problem: nil}]
  end

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event(_event, _params, %{assigns: %{start: nil}} = socket), do: socket

  def handle_event(
        "start_sample",
        _params,
        %{assigns: %{start: %{sample: sample, progress: nil}}} = socket
      )
      when sample != nil do
    %{studio: studio, start: start} = socket.assigns
    run_task(:sample, fn page -> make_sample(sample, start.folder, studio, page) end)
    assign(socket, start: %{start | progress: 0.0, problem: nil})
  end

  def handle_event(
        "start_camera",
        _params,
        %{assigns: %{start: %{folder: folder}} = assigns} = socket
      )
      when folder != nil do
    case CameraRecording.start_recording(assigns.studio, folder) do
      {:ok, %{page: page, recording: recording}} ->
        Catalog.invalidate_recordings(assigns.studio)
        query = URI.encode_query(%{"name" => page, "recording" => recording})
        push_event(socket, "go", %{href: "sensor?" <> query})

      {:error, error} ->
        show_problem(socket, :camera, error)
    end
  end

  def handle_event("start_connect", %{"address" => address, "token" => token}, socket)
      when is_binary(address) and is_binary(token) do
    studio = socket.assigns.studio
    run_task(:connect, fn _page -> Catalog.connect(studio, address, token) end)
    assign(socket, start: %{socket.assigns.start | connecting: true, problem: nil})
  end

  def handle_event(_event, _params, socket), do: socket

  # A task that fails sends its error, so that the page does not wait for ever.
  defp run_task(what, fun) do
    page = self()

    {:ok, _} =
      Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
        result =
          try do
            fun.(page)
          rescue
            error -> {:error, error}
          end

        send(page, {:start_panel, what, result})
      end)
  end

  defp make_sample(sample, folder, studio, page) do
    report = &send(page, {:start_panel, :progress, &1})

    with {:ok, path} <- sample.create(folder, report) do
      Catalog.invalidate_recordings(studio)
      {:ok, Path.relative_to(path, Path.expand(folder))}
    end
  end

  @spec handle_info({:start_panel, atom(), term()}, Socket.t()) :: Socket.t()
  def handle_info({:start_panel, :progress, progress}, %{assigns: %{start: start}} = socket),
    do: assign(socket, start: %{start | progress: progress})

  def handle_info({:start_panel, what, result}, %{assigns: %{start: start}} = socket) do
    socket = assign(socket, start: %{start | progress: nil, connecting: false})

    case {what, result} do
      {:sample, {:ok, id}} ->
        push_event(socket, "go", %{href: Paths.source_path(id)})

      {:connect, {:ok, [id]}} ->
        push_event(socket, "go", %{href: Paths.source_path(id)})

      {:connect, {:ok, ids}} ->
        push_event(socket, "toast", %{text: "#{length(ids)} recordings added to the list"})

      {way, {:error, error}} ->
        show_problem(socket, way, error)
    end
  end

  # The text stays until the next attempt, because it says what to do.
  defp show_problem(%{assigns: %{start: start}} = socket, way, error),
    do: assign(socket, start: %{start | problem: {way, Exception.message(error)}})

  attr(:start, :map, required: true)
  attr(:open, :boolean, required: true)

  @doc "Renders the panel, unfolded if `open`."
  @spec start_panel(map()) :: Situ.Live.Rendered.t()
  def start_panel(assigns) do
    ~H"""
    <details id="start" class="start" open={@open} phx-hook="Upload" data-uploads={@start.folder && "yes"}>
      <summary>Add recordings</summary>
      <div class="ways">
        <section :if={@start.folder}>
          <h2>Add a file</h2>
          <p>Drop a file on this page: video, audio, CSV, MCAP, ROS bags, \psi stores and others. It is copied to
            the folder {Path.basename(Path.expand(@start.folder))}.</p>
          <p><label class="btn primary">Choose a file<input id="upload-file" type="file" multiple></label>
            <label class="btn">Choose a folder<input id="upload-folder" type="file" webkitdirectory></label></p>
          <p id="upload-state" role="status" phx-update="ignore"></p>
        </section>
        <section :if={@start.sample}>
          <h2>Open a sample</h2>
          <p>{@start.sample.describe()} A pipeline records it now, on this machine, in a few seconds.</p>
          <p><button class="btn primary" type="button" phx-click="start_sample"
            disabled={@start.progress != nil}>{sample_label(@start.progress)}</button></p>
          <progress :if={@start.progress} value={@start.progress} max="1"
            aria-label="Progress of the sample"></progress>
          <.problem start={@start} way={:sample} />
        </section>
        <section :if={@start.folder}>
          <h2>Record with this camera</h2>
          <p>Records the camera and the microphone of this browser, until its page is closed.</p>
          <p><button class="btn primary" type="button" phx-click="start_camera">Open the camera page</button></p>
          <.problem start={@start} way={:camera} />
        </section>
        <section>
          <h2>Connect to another machine</h2>
          <p>Shows the recordings of a machine that runs <code>situ serve</code>, also while they are written.</p>
          <form id="connect-form" phx-submit="start_connect">
            <input name="address" aria-label="Address" placeholder="situ://192.168.0.12" required autocomplete="off"
                spellcheck="false" maxlength="300">
            <input name="token" type="password" aria-label="Token" placeholder="Token, if it needs one"
                autocomplete="off" maxlength="300">
            <button class="btn primary" type="submit" disabled={@start.connecting}>{connect_label(@start)}</button>
          </form>
          <.problem start={@start} way={:connect} />
        </section>
      </div>
    </details>
    """
  end

  attr(:start, :map, required: true)
  attr(:way, :atom, required: true)

  defp problem(%{start: %{problem: problem}, way: way} = assigns) do
    assigns = assign(assigns, text: with({^way, text} <- problem, do: text, else: (_ -> nil)))

    ~H"""
    <p :if={@text} class="problem" role="alert">{@text}</p>
    """
  end

  defp sample_label(nil), do: "Make the sample"
  defp sample_label(progress), do: "Recording: #{round(progress * 100)} %"

  defp connect_label(%{connecting: true}), do: "Connecting"
  defp connect_label(_start), do: "Connect"
end

defmodule Situ.Studio.Web.Dataset.BatchDialog do
  @moduledoc false
  # Renders the dialog that runs a batch task: a form with its options, the sessions to process, and saved options.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Dataset
  alias Situ.Dataset.Session
  alias Situ.Live.Socket
  alias Situ.Studio.BatchRuns
  alias Situ.Studio.BatchRuns.{SavedOptions, Form, ResumableRuns}
  alias Situ.Studio.Web.Dataset.Rows

  @doc "Opens the dialog for the named task, with one session selected or all sessions that the search found."
  @spec open_dialog(Socket.t(), term(), [String.t()]) :: Socket.t()
  def open_dialog(socket, name, path) do
    case Enum.find(socket.assigns.tasks, &(&1.name == name)) do
      nil -> socket
      task -> assign(socket, dialog: {:task, build_state(task, path, socket.assigns)})
    end
  end

  defp build_state(task, path, assigns) do
    found =
      for %{kind: :session, label: name} <-
            Rows.visible_rows(assigns.dataset, assigns.facts, assigns.open, assigns.query),
          do: name

    {config, output} = find_earlier_run(task, path, assigns.dataset)

    %{
      task: task,
      sessions: found,
      chosen: if(path == [], do: found, else: Enum.take(path, 1)),
      config: config,
      output: output,
      saved: SavedOptions.list_all(assigns.folder, task.name),
      picked: "",
      again: 0,
      error: nil
    }
  end

  # For a partition that this task has made, the dialog offers to make it again with the same options.
  defp find_earlier_run(%{name: task} = about, [session, partition | _], dataset) do
    with {:ok, session} <- Dataset.session(dataset, session),
         {:ok, %{extra: %{"provenance" => %{"task" => ^task, "options" => %{} = options}}}} <-
           Session.fetch_partition(session, partition),
         do: {options, partition},
         else: (_ -> {%{}, about.output})
  end

  defp find_earlier_run(about, _path, _dataset), do: {%{}, about.output}

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event("run_cancel", %{"run" => run}, socket) do
    with {id, ""} <- Integer.parse(to_string(run)),
         do: BatchRuns.cancel_run(socket.assigns.studio, id)

    socket
  end

  # Continues a run that was interrupted when its studio stopped; sessions already processed are kept.
  def handle_event("run_continue", %{"output" => output}, %{assigns: assigns} = socket) do
    with %{} = left <- Enum.find(assigns.left, &(to_string(&1.output) == output)),
         opts = [output: left.output, parallel: left.parallel],
         dataset = {assigns.server, assigns.file},
         {:ok, _} <-
           BatchRuns.start_run(
             assigns.studio,
             dataset,
             left.task,
             left.sessions,
             left.config,
             opts
           ) do
      assign(socket, left: ResumableRuns.list_interrupted(assigns.file))
    else
      {:error, error} -> push_event(socket, "toast", %{text: Exception.message(error)})
      nil -> socket
    end
  end

  def handle_event("run_leave", %{"output" => output}, %{assigns: assigns} = socket) do
    for left <- assigns.left,
        to_string(left.output) == output,
        do: ResumableRuns.delete_record(assigns.file, left.output)

    assign(socket, left: ResumableRuns.list_interrupted(assigns.file))
  end

  def handle_event("run_pick", %{"saved" => name}, %{assigns: %{dialog: {:task, state}}} = socket) do
    config = Enum.find_value(state.saved, %{}, fn {n, config} -> if n == name, do: config end)
    put_state(socket, %{state | config: config, picked: name, again: state.again + 1, error: nil})
  end

  def handle_event(
        "run_forget",
        _,
        %{assigns: %{dialog: {:task, state}, folder: folder}} = socket
      ) do
    SavedOptions.delete(folder, state.task.name, state.picked)

    put_state(socket, %{
      state
      | saved: SavedOptions.list_all(folder, state.task.name),
        picked: ""
    })
  end

  def handle_event("run_start", params, %{assigns: %{dialog: {:task, state}} = assigns} = socket) do
    chosen =
      for {name, i} <- Enum.with_index(state.sessions),
          checked?(params, "session", "#{i}"),
          do: name

    state = %{state | chosen: chosen}

    with {:ok, config} <- Form.parse_config(state.task.options, params["option"] || %{}),
         state = %{state | config: config},
         :ok <- save_options(params["keep"], state, assigns.folder),
         {:ok, _} <- start_run(assigns, state, chosen, config, params) do
      assign(socket, dialog: nil)
    else
      {:error, error} -> put_state(socket, %{state | error: Exception.message(error)})
    end
  end

  def handle_event(_, _, socket), do: socket

  defp start_run(assigns, state, chosen, config, params) do
    opts = [overwrite: params["overwrite"] == "true"]
    output = params["output"] |> to_string() |> String.trim()
    opts = if state.output && output != "", do: [output: output] ++ opts, else: opts
    opts = put_parallel(params["parallel"], opts)
    dataset = {assigns.server, assigns.file}
    BatchRuns.start_run(assigns.studio, dataset, state.task.name, chosen, config, opts)
  end

  defp put_parallel(text, opts) do
    case Integer.parse(to_string(text)) do
      {n, _} when n in 1..64 -> [parallel: n] ++ opts
      _ -> opts
    end
  end

  defp checked?(params, group, key), do: get_in(params, [group, key]) in ["true", "on"]

  defp save_options(name, state, folder) when is_binary(name) do
    if String.trim(name) == "",
      do: :ok,
      else: SavedOptions.save(folder, state.task.name, String.trim(name), state.config)
  end

  defp save_options(_, _, _), do: :ok

  defp put_state(socket, state), do: assign(socket, dialog: {:task, state})

  attr(:dialog, :any, required: true)

  @doc false
  def run_dialog(assigns) do
    {:task, state} = assigns.dialog

    assigns =
      assign(assigns,
        s: state,
        fields: Form.build_fields(state.task.options, state.config),
        all: length(state.sessions)
      )

    ~H"""
    <dialog id="task" class="task" phx-hook="Modal" aria-label={"Run " <> @s.task.name}>
      <h3>Run {@s.task.name}</h3>
      <p class="hint">{@s.task.about}</p>
      <form :if={@s.saved != []} id="task-saved" phx-change="run_pick">
        <label>Saved options
          <select name="saved"><option value="">Default options</option><option :for={{name, _} <- @s.saved}
              value={name} selected={name == @s.picked}>{name}</option></select></label>
        <button :if={@s.picked != ""} class="btn" type="button" phx-click="run_forget">Delete {@s.picked}</button>
      </form>
      <form id={"task-form-#{@s.again}"} phx-submit="run_start">
        <div :for={f <- @fields} class="option">
          <label for={"option-" <> f.name}>{f.name}{if f.required, do: " *"}</label>
          <.option_input field={f} />
          <p :if={f.doc} class="hint">{f.doc}</p>
        </div>
        <div :if={@s.output} class="option"><label for="task-output">Output partition</label>
          <input id="task-output" name="output" value={@s.output} maxlength="200">
          <label class="check"><input type="checkbox" name="overwrite" value="true">
            Replace an existing partition with this name</label>
        </div>
        <div class="option"><label for="task-parallel">Sessions in parallel</label>
          <input id="task-parallel" name="parallel" type="number" min="1" max="64" value="1"></div>
        <fieldset>
          <legend>Sessions</legend>
          <div class="pick">
            <label :for={{name, i} <- Enum.with_index(@s.sessions)}><input type="checkbox" name={"session[#{i}]"}
                value="true" checked={name in @s.chosen}> {name}</label>
          </div>
        </fieldset>
        <div class="option"><label for="task-keep">Save these options as</label>
          <input id="task-keep" name="keep" maxlength="60" placeholder="leave empty to skip" autocomplete="off"></div>
        <div class="error" role="alert">{@s.error}</div>
        <div class="choices">
          <button class="btn primary" type="submit">Run</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end

  attr(:field, :map, required: true)

  defp option_input(assigns) do
    assigns =
      assign(assigns, id: "option-" <> assigns.field.name, name: "option[#{assigns.field.name}]")

    ~H"""
    <input :if={@field.kind == :check} id={@id} type="checkbox" name={@name} value="true"
        checked={@field.value == true}>
    <select :if={@field.kind == :choice} id={@id} name={@name}><option :for={c <- @field.choices} value={c}
        selected={c == @field.value}>{c}</option></select>
    <input :if={@field.kind in [:text, :number]} id={@id} name={@name} value={@field.value}
        required={@field.required} inputmode={if @field.kind == :number, do: "decimal", else: "text"}
        autocomplete="off">
    """
  end
end

defmodule Situ.Studio.Web.CompareBar do
  @moduledoc false
  # Compares two recordings on one time axis: selects the second recording and its time offset. The page's script lets
  # the user drag the offset.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]
  import Situ.Studio.Web.Icons

  alias Situ.Live.Socket
  alias Situ.Studio.{Catalog, Comparison, Int64}

  @spec handle_event(String.t(), map(), Socket.t()) :: {:noreply, Socket.t()}
  def handle_event("compare_dialog", _, %{assigns: assigns} = socket) do
    others =
      for %{kind: kind} = item <- Catalog.list(assigns.studio) ++ list_sessions(assigns),
          kind != :dataset and item.id != assigns.id,
          uniq: true,
          do: {item.id, item.title}

    {:noreply, assign(socket, dialog: {:compare, others})}
  end

  # The page then navigates to the address that shows the comparison.
  def handle_event("compare_with", %{"with" => other}, %{assigns: assigns} = socket) do
    case Comparison.open_item(assigns.studio, assigns.id, %{"with" => other}) do
      {:ok, _item, _source, %Comparison{} = compared} ->
        params = %{with: other, offset: Integer.to_string(compared.offset)}
        {:noreply, socket |> assign(dialog: nil) |> push_event("compare_go", params)}

      {:ok, _item, _source, nil} ->
        {:noreply, socket}

      {:error, error} ->
        {:noreply, push_event(socket, "toast", %{text: Exception.message(error)})}
    end
  end

  # The page has shifted the second recording. Later reads of it return the shifted times.
  def handle_event("compare_offset", %{"offset" => text}, %{assigns: assigns} = socket) do
    with %Comparison{} = compared <- assigns.compared,
         {:ok, offset} <- Int64.parse(text) do
      {:noreply,
       assign(socket,
         compared: %{compared | offset: offset},
         source: Comparison.set_offset(assigns.source, offset)
       )}
    else
      _ -> {:noreply, socket}
    end
  end

  def handle_event(_, _, socket), do: {:noreply, socket}

  # In a dataset, sessions are compared with sessions.
  defp list_sessions(%{sources: sources}),
    do: for(%{kind: :session} = s <- sources, do: %{id: s.id, title: s.title, kind: :session})

  attr(:compared, :any, required: true)
  attr(:title, :string, required: true)

  @doc false
  def comparison_bar(assigns) do
    ~H"""
    <section id="compare" class="compare" phx-hook="Compare" phx-update="ignore" aria-label="Comparison"
        data-with={@compared.id} data-offset={@compared.offset} data-title={@title} data-other={@compared.title}
        data-first={encode_extent(@compared.first)} data-second={encode_extent(@compared.second)}>
      <span class="who"><b>{@title}</b> and <b>{@compared.title}</b></span>
      <div class="shift" tabindex="0" role="slider" aria-label={"Shift of " <> @compared.title} aria-valuenow="0"
          title="Drag, or use the arrow keys (Shift: ten times as far)">⟷ drag to shift {@compared.title}</div>
      <label>starts <input name="offset" autocomplete="off" spellcheck="false"
          aria-label="How much later it starts"> later</label>
      <button class="btn" type="button" data-align="begin" title="Align the starts">Starts</button>
      <button class="btn" type="button" data-align="end" title="Align the ends">Ends</button>
      <button class="btn" type="button" data-align="clock" title="Use the recorded clock times">Clock</button>
      <span class="hint marks" role="status"></span>
      <button class="mini" type="button" data-align="stop" title="Stop comparing"
          aria-label="Stop comparing"><.icon name={:close} /></button>
    </section>
    """
  end

  defp encode_extent(extent), do: "#{extent.from}~#{extent.to}"

  attr(:others, :list, required: true)

  @doc false
  def comparison_dialog(assigns) do
    ~H"""
    <dialog id="compare-dialog" phx-hook="Modal" phx-update="ignore" aria-label="Compare with another recording">
      <form id="compare-with" phx-submit="compare_with">
        <h3>Compare with another recording</h3>
        <p class="hint">Its streams are drawn next to the streams of this recording, on the same time axis.</p>
        <select class="select" name="with" aria-label="Recording" autofocus>
          <option :for={{id, title} <- @others} value={id}>{title}</option>
        </select>
        <div class="choices">
          <button class="btn primary" type="submit">Compare</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end
end

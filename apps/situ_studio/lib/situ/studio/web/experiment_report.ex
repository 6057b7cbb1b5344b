defmodule Situ.Studio.Web.ExperimentReport do
  @moduledoc false
  # Serves the report on a run of an experiment over HTTP: as a page of HTML, or as text in Markdown.
  alias Situ.Experiment.{ReportPage, ReportTable}
  alias Situ.Live.{Request, Response}
  alias Situ.Studio.{Catalog, Experiments}

  @spec call(Request.t(), Catalog.id()) :: Response.t()
  def call(%Request{query: query}, studio) do
    with {:ok, %{kind: :dataset, path: file}} <- Catalog.fetch_item(studio, query["dataset"]),
         name when is_binary(name) <- query["run"],
         %Experiments{run: %{} = run} = state <- Experiments.load_run(file, name) do
      render_report(query["format"], state.rows, Map.put(run, "status", state.status))
    else
      _ -> Response.error(404, "there is no such run")
    end
  end

  defp render_report("markdown", rows, run) do
    Response.text(ReportTable.render_report(rows, run))
    |> Response.put_header("content-disposition", ~s(attachment; filename="#{run["run"]}.md"))
  end

  defp render_report(_html, rows, run), do: Response.html(ReportPage.render_page(rows, run))
end

defmodule Situ.Conformance.Datasets.Paths do
  # Where a recording lies, as the dataset file says it and as it is.
  import Situ.Conformance.Case
  alias Situ.Dataset.StoredPath

  def run("dataset.path_to_stored", %{"dataset_file" => file, "path" => path}, case, _root),
    do: verdict(case["expect"]["stored"], StoredPath.to_stored(path, file))

  def run("dataset.path_from_stored", %{"dataset_file" => file, "stored" => stored}, case, _root),
    do: verdict(case["expect"]["path"], StoredPath.from_stored(stored, file))
end

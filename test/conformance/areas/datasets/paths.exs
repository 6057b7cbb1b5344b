defmodule Situ.Conformance.Datasets.Paths do
  # The location of a recording, as stored in the dataset file and as resolved.
  import Situ.Conformance.Case
  alias Situ.Dataset.StoredPath

  def run("dataset.path_to_stored", %{"dataset_file" => file, "path" => path}, case, _root),
    do: verdict(case["expect"]["stored"], StoredPath.to_stored(path, file))

  def run("dataset.path_from_stored", %{"dataset_file" => file, "stored" => stored}, case, _root),
    do: verdict(case["expect"]["path"], StoredPath.from_stored(stored, file))
end

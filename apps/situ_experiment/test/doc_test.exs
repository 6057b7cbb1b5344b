defmodule Situ.Experiment.DocTest do
  use ExUnit.Case, async: true

  for module <- Application.spec(:situ_experiment, :modules) do
    doctest module
  end
end

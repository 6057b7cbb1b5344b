Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Cluster.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_cluster, deps: [:situ, :situ_link, :situ_store, :situ_types])
  end

  def application do
    Situ.MixApp.application([:crypto], env: [metrics: [Situ.Cluster.ClusterMetrics]])
  end
end

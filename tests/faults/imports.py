"""Imports that take a command seconds; they are not used here."""

import hydra  # noqa: F401
import lightning  # noqa: F401
import mlflow.store.tracking.sqlalchemy_store
import mlflow.tracking  # noqa: F401

import symo_exp.job.recipe
import symo_exp.models.e2e_symo
import symo_exp.models.l_node
import symo_exp.models.node
import symo_exp.models.symo
import symo_exp.optim.chained
import symo_exp.optim.lbfgs
import symo_exp.sweep.sweeper
import symo_exp.tracking.publish  # noqa: F401
